//! The option `--force` for existing results.

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
    /// Checks that the files can be written. Files among `inputs` are never overwritten.
    pub fn check<'a>(&self, paths: impl IntoIterator<Item = &'a Path>, inputs: &[&Path]) -> Result<(), OutputError> {
        check_outputs(paths, inputs, if self.force { Existing::Replace } else { Existing::Keep })
    }

    /// Opens the folder for results, which must not contain results unless `--force` is given; `folders` are its subfolders.
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
