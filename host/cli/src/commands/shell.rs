//! `simod completions` and `simod manual`: completions for shells and pages for `man`, made from the
//! program's own arguments.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{Args, Command};
use clap_complete::Shell;
use clap_mangen::Man;
use simod_model::{Error, Result, output};

/// Name of the program.
const NAME: &str = "simod";

/// Print completions for a shell
#[derive(Args)]
pub struct Completions {
    /// Shell to complete for
    #[arg(value_enum)]
    shell: Shell,
}

/// Write the manual pages, one for each command
#[derive(Args)]
pub struct Manual {
    /// Folder to write the pages to
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

impl Completions {
    /// Prints the completions. `program` has all arguments of the program.
    pub fn execute(self, mut program: Command) -> Result<()> {
        let mut text = Vec::new();
        clap_complete::generate(self.shell, &mut program, NAME, &mut text);
        let written = std::io::stdout().write_all(&text);
        written.map_err(|e| Error::io("write to", Path::new("standard output"), &e))
    }
}

impl Manual {
    /// Writes the pages. `program` has all arguments of the program.
    pub fn execute(self, mut program: Command) -> Result<()> {
        std::fs::create_dir_all(&self.output).map_err(|e| Error::io("make the folder", &self.output, &e))?;
        program = program.name(NAME);
        program.build();
        self.pages(program, NAME)
    }

    /// The page of a command, called `name`, and those of the commands below it.
    fn pages(&self, command: Command, name: &str) -> Result<()> {
        let below = command.get_subcommands().filter(|c| !c.is_hide_set() && c.get_name() != "help");
        for below in below {
            self.pages(below.clone(), &format!("{name}-{}", below.get_name()))?;
        }
        let path = self.output.join(format!("{name}.1"));
        let mut page = Vec::new();
        let page_of = Man::new(command.display_name(name)).title(name.to_uppercase());
        let made = page_of.source(concat!("simod ", env!("CARGO_PKG_VERSION"))).render(&mut page);
        made.map_err(|e| Error::io("make", &path, &e))?;
        output::write_file(&path, &page)
    }
}
