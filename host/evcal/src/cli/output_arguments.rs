//! Results that are there already: one rule for all subcommands that can make theirs again.

use std::path::Path;

use evcal_files::folder::{FolderError, OutputFolder};
use evcal_files::output::{Existing, OutputError, check_outputs};

/// Options of every subcommand that writes results.
#[derive(clap::Args)]
pub struct OutputArguments {
    /// Overwrite existing results [default: stop with an error]
    #[arg(long)]
    force: bool,
}

impl OutputArguments {
    /// Whether the files can be written; `inputs` are those that are read, and stay in any case.
    pub fn check<'a>(&self, paths: impl IntoIterator<Item = &'a Path>, inputs: &[&Path]) -> Result<(), OutputError> {
        check_outputs(paths, inputs, if self.force { Existing::Replace } else { Existing::Keep })
    }

    /// The folder for results, which holds none yet unless they may be replaced; `folders` are those that results have in it.
    pub fn open_folder(
        &self,
        path: &Path,
        is_result: impl Fn(&Path) -> bool,
        folders: &[&str],
    ) -> Result<OutputFolder, FolderError> {
        let folder = match self.force {
            true => OutputFolder::open(path),
            false => OutputFolder::open_new(path, &is_result),
        }?;
        folder.check_paths(is_result, folders)?;
        Ok(folder)
    }
}
