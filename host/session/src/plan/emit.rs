//! Plans as scripts of the engines that do their units.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use simod_model::{Error, Result};

use super::units::{FINISHED, Stage, Unit};

/// An engine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Emit {
    /// `Makefile`, for as many processes at a time as `make -j` says.
    Make,
    /// The script `slurm.sh`, which submits a job for each stage, and arrays of jobs for stages of several
    /// units.
    Slurm,
    /// `commands.txt`, a line for each unit, by stages: for render farms.
    Commands,
}

impl Emit {
    /// The names of the scripts.
    pub(super) const FILES: [&str; 3] = ["Makefile", "slurm.sh", "commands.txt"];
}

/// The script of a plan's units, whose folder will be there: its name, and its text.
///
/// # Errors
/// The program's own path, or that of the folder, is no text.
pub fn emit(units: &[Unit], how: Emit, folder: &Path) -> Result<(&'static str, String)> {
    let folder = std::path::absolute(folder).map_err(|e| Error::io("read", folder, &e))?;
    let program = std::env::current_exe().unwrap_or_else(|_| PathBuf::from("simod"));
    let text = |path: &Path| path.to_str().map(quoted).ok_or_else(|| no_text(path));
    let (program, folder) = (text(&program)?, text(&folder)?);
    Ok(match how {
        Emit::Make => (Emit::FILES[0], makefile(units, &program)),
        Emit::Slurm => (Emit::FILES[1], slurm(units, &program)),
        Emit::Commands => (Emit::FILES[2], commands(units, &program, &folder)),
    })
}

fn no_text(path: &Path) -> Error {
    let what = format!("{} is no name that a script can hold", path.display());
    Error::argument(what, "give it a name in UTF-8")
}

/// A word for the shell.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

/// Text of the plan for `make`, in whose language a dollar is written twice.
fn makefile(units: &[Unit], program: &str) -> String {
    let file = |number: &usize| units[*number].writes.display().to_string();
    let mut text = format!(
        "# Made by `simod plan`: `make -j 8` does all units, eight at a time where they allow.\n\
         # SIMOD is the program, and OPTIONS what each call is given besides, as --threads 2.\n\
         SIMOD ?= {}\nOPTIONS ?=\n\n.PHONY: all\nall: {FINISHED}\n\n",
        program.replace('$', "$$")
    );
    let is_removed = |unit: &&Unit| {
        use Stage::{Apply, Cluster, ClusterShared, Faces, Members, Method};
        matches!(unit.stage, Cluster | ClusterShared | Members | Faces | Apply | Method)
    };
    let parts: Vec<String> = units.iter().filter(is_removed).map(|unit| file(&unit.number)).collect();
    if !parts.is_empty() {
        // Units remove these files in the end, and make does not make them again for that.
        let _ = writeln!(text, ".SECONDARY: {}\n", parts.join(" "));
    }
    for Unit { number, stage, after, .. } in units {
        let before: Vec<String> = after.iter().map(file).collect();
        let _ = write!(
            text,
            "# {}\n{}: {}\n\t$(SIMOD) $(OPTIONS) unit . {number}\n\n",
            stage.name(),
            file(number),
            before.join(" ")
        );
    }
    text
}

/// The units of each stage, which follow each other.
fn stages(all: &[Unit]) -> Vec<(Stage, Vec<&Unit>)> {
    let mut stages: Vec<(Stage, Vec<&Unit>)> = Vec::new();
    for unit in all {
        match stages.last_mut() {
            Some((stage, units)) if *stage == unit.stage => units.push(unit),
            _ => stages.push((unit.stage, vec![unit])),
        }
    }
    stages
}

fn slurm(units: &[Unit], program: &str) -> String {
    let mut text = format!(
        "#!/bin/sh\n# Made by `simod plan`: `sh slurm.sh` submits all units, an array of jobs for each stage that\n\
         # has several. SIMOD is the program, and SBATCH_OPTIONS what sbatch is given besides, as \"--time=2:00:00 -c 8\".\n\
         # A job that failed, or was killed, may be submitted again: what is there is not done again.\n\
         set -eu\ncd \"$(dirname \"$0\")\"\nsimod=${{SIMOD:-{program}}}\n\
         submit() {{\n    stage=$1\n    shift\n    job=$(sbatch --parsable --job-name=\"simod-$stage\" ${{SBATCH_OPTIONS:-}} \"$@\")\n    \
         echo \"${{job%%;*}}\"\n}}\n"
    );
    let mut jobs: Vec<String> = vec![String::new(); units.len()];
    for (number, (stage, units)) in stages(units).into_iter().enumerate() {
        let before: BTreeSet<&String> =
            units.iter().flat_map(|unit| &unit.after).map(|n| &jobs[*n]).collect();
        let before: Vec<String> = before.into_iter().map(|job| format!("${{{job}}}")).collect();
        let after = if before.is_empty() {
            String::new()
        } else {
            format!(" --dependency=\"afterok:{}\"", before.join(":"))
        };
        let (array, unit) = match &units[..] {
            [one] => (String::new(), one.number.to_string()),
            several => {
                let (first, last) = (several[0].number, several[several.len() - 1].number);
                (format!(" --array={first}-{last}"), "\\$SLURM_ARRAY_TASK_ID".to_owned())
            }
        };
        let (job, name) = (format!("job{number}"), stage.name());
        let _ = writeln!(text, "{job}=$(submit {name}{after}{array} --wrap \"$simod unit . {unit}\")");
        units.iter().for_each(|unit| jobs[unit.number].clone_from(&job));
    }
    text.push_str("echo \"the output is there once the last job is done\"\n");
    text
}

fn commands(units: &[Unit], program: &str, folder: &str) -> String {
    let mut text =
        "# Made by `simod plan`: a unit on each line. Those of a stage may be done at the same time, once\n\
                    # those of all stages before it are done.\n"
            .to_owned();
    for (number, (stage, units)) in stages(units).into_iter().enumerate() {
        let _ = writeln!(text, "# stage {}: {}", number + 1, stage.name());
        units.iter().for_each(|unit| {
            let _ = writeln!(text, "{program} unit {folder} {}", unit.number);
        });
    }
    text
}

#[cfg(test)]
mod tests {
    use super::quoted;

    #[test]
    fn words_of_the_shell_are_one_word() {
        assert_eq!(quoted("/usr/bin/simod"), "/usr/bin/simod");
        assert_eq!(quoted("/my models/it's $5"), r"'/my models/it'\''s $5'");
        assert_eq!(quoted(""), "''");
    }
}
