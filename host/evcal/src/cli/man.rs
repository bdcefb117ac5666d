//! `evcal man`.

use std::path::PathBuf;

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
    let write = |name: String, command: clap::Command| {
        let mut page = Vec::new();
        Man::new(command).render(&mut page)?;
        let path = folder.path().join(format!("{name}.1"));
        evcal_files::write(&path, &page)?;
        print::line(format!("written to {}", visible::path(path)))
    };
    for subcommand in command.get_subcommands().filter(|subcommand| subcommand.get_name() != "help") {
        write(format!("evcal-{}", subcommand.get_name()), subcommand.clone())?;
    }
    write("evcal".to_owned(), command.clone())
}
