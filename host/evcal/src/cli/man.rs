//! `evcal man`.

use std::path::{Path, PathBuf};

use clap::CommandFactory as _;
use clap_mangen::Man;
use evcal_files::folder::OutputFolder;
use evcal_files::visible;

use super::print;

/// Arguments of `evcal man`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Folder for evcal.1 and a page for each subcommand
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

/// Runs `evcal man`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let folder = OutputFolder::open(&arguments.folder)?;
    let mut command = super::Arguments::command();
    command.build();
    let page = |name: String, command: clap::Command| -> std::io::Result<(PathBuf, Vec<u8>)> {
        let mut page = Vec::new();
        Man::new(command).render(&mut page)?;
        Ok((folder.path().join(format!("{name}.1")), page))
    };
    let subcommands = command.get_subcommands().filter(|subcommand| subcommand.get_name() != "help");
    let named = subcommands.map(|subcommand| (format!("evcal-{}", subcommand.get_name()), subcommand.clone()));
    let named = named.chain([("evcal".to_owned(), command.clone())]);
    let pages = named.map(|(name, command)| page(name, command)).collect::<Result<Vec<_>, _>>()?;
    let files: Vec<(&Path, &[u8])> = pages.iter().map(|(path, page)| (path.as_path(), page.as_slice())).collect();
    evcal_files::write_all(&files)?;
    pages.iter().try_for_each(|(path, _)| print::line(format!("written to {}", visible::path(path))))
}
