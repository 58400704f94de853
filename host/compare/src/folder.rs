//! The folder of a comparison: the contents that may be replaced, and the names of its files.

use crate::file::ComparedMethod;
use crate::html::hyphenated;
use serde::Deserialize;
use simod_model::target::folder_of;
use simod_model::{Error, Result, input};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// The page.
pub(crate) const INDEX: &str = "index.html";

/// The figures of the methods as tables, for other programs and for papers.
pub(crate) const CSV: &str = "compare.csv";
pub(crate) const LATEX: &str = "compare.tex";

/// The file with all figures.
pub(crate) const RECORD: &str = "compare.json";

/// Greatest length of a record, in bytes.
const LONGEST: u64 = 64 << 20;

/// Beginning of the names of pictures of the model at rest.
pub(crate) const REST: &str = "rest";

/// Name of the format, which is written into the record.
pub(crate) const FORMAT: &str = "simod-comparison/1";

/// A place where a comparison may be written.
pub(crate) struct ComparisonFolder(PathBuf);

/// Part of a record that tells which files are the comparison's own.
#[derive(Deserialize)]
struct Former {
    format: String,
    files: Vec<String>,
}

impl ComparisonFolder {
    /// Checks a place, before any work is done: it has to be free, or to hold a former comparison, in which
    /// the model does not lie.
    pub fn check(folder: &Path, model: &[PathBuf]) -> Result<Self> {
        let this = Self(folder.to_owned());
        this.check_again()?;
        if let Ok(folder) = folder.canonicalize()
            && model.iter().any(|file| file.canonicalize().is_ok_and(|file| file.starts_with(&folder)))
        {
            return Err(this.refused("holds the model itself"));
        }
        Ok(this)
    }

    /// Checks the folder once more, when all is done.
    pub fn check_again(&self) -> Result<()> {
        let folder = &self.0;
        if folder.symlink_metadata().is_err() {
            let parent = folder_of(folder);
            let failed = |e: std::io::Error| Error::io("write", folder, &e);
            let is_folder = std::fs::metadata(parent).map_err(failed)?.is_dir();
            return if is_folder { Ok(()) } else { Err(failed(std::io::ErrorKind::NotADirectory.into())) };
        }
        let former = input::read(&folder.join(RECORD), LONGEST).ok();
        let former: Option<Former> = former.and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let Some(former) = former.filter(|former| former.format == FORMAT) else {
            return Err(self.refused("exists and is no comparison"));
        };
        // A former comparison is removed: no file of the user's own may be in it.
        let entries = std::fs::read_dir(folder).map_err(|e| Error::io("read", folder, &e))?;
        let is_foreign = |name: &std::ffi::OsString| !former.files.iter().any(|own| **own == **name);
        match entries.flatten().map(|e| e.file_name()).find(is_foreign) {
            Some(name) => Err(self.refused(&format!("holds {} beside the comparison", name.display()))),
            None => Ok(()),
        }
    }

    fn refused(&self, what: &str) -> Error {
        let hint = "give the name of a new folder, or of a former comparison to replace";
        Error::argument(format!("{} {what}", self.0.display()), hint)
    }
}

/// Names for the files of methods: the ASCII letters and digits of the methods' names. `NAME.png` and
/// `NAME-difference.png` are of one method alone; no name has the `_` that stands before the names of
/// crops.
pub(crate) fn names(methods: &[ComparedMethod]) -> Vec<String> {
    const LONGEST: usize = 60;
    let mut taken: HashSet<String> = ["rest", "index", "compare", "difference"].map(String::from).into();
    let name = |method: &ComparedMethod| {
        let mut name = hyphenated(&method.name);
        name.truncate(LONGEST);
        if name.is_empty() {
            name.push_str("method");
        }
        let mut numbered = name.clone();
        let mut number = 1;
        while [numbered.clone(), difference(&numbered)].iter().any(|n| taken.contains(n)) {
            number += 1;
            numbered = format!("{name}-{number}");
        }
        taken.extend([numbered.clone(), difference(&numbered)]);
        numbered
    };
    methods.iter().map(name).collect()
}

/// The name of the picture of differences, without its ending.
pub(crate) fn difference(name: &str) -> String {
    format!("{name}-difference")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CompareFile;

    #[test]
    fn files_have_names_of_their_own() {
        let method = |name: &str| format!("[[method]]\nname = '{name}'\ndeform = 'x'\n");
        let methods =
            ["as rigid, as (possible)", "As rigid as possible", "rest", "a", "a difference", "../ä", "日本"];
        let text = format!("model = {{ path = 'a' }}\n{}", methods.map(method).concat());
        let file = CompareFile::parse(&text, Path::new("c.toml")).unwrap();
        let expected = [
            "as-rigid-as-possible",
            "as-rigid-as-possible-2",
            "rest-2",
            "a",
            "a-difference-2",
            "method",
            "method-2",
        ];
        assert_eq!(names(&file.methods), expected);
    }

    #[test]
    fn only_former_comparisons_are_replaced() {
        let place = tempfile::tempdir().unwrap();
        let at = |name: &str| place.path().join(name);
        let check = |name: &str| ComparisonFolder::check(&at(name), &[at("out/a.ply")]).map(|_| ());
        let write = |name: &str, text: &str| {
            std::fs::create_dir_all(at(name).parent().unwrap()).unwrap();
            simod_model::output::write_file(&at(name), text.as_bytes()).unwrap();
        };
        check("new").unwrap();
        assert!(check("missing/new").is_err());
        let record = |files: &str| format!(r#"{{"format": "{FORMAT}", "files": [{files}], "more": 1}}"#);
        write("out/compare.json", &record(r#""compare.json", "a.ply""#));
        check("out").unwrap();
        write("out/a.ply", "ply");
        assert!(check("out").unwrap_err().to_string().contains("holds the model itself"));
        write("other/compare.json", &record(r#""compare.json""#));
        write("other/thesis.tex", "");
        assert!(check("other").unwrap_err().to_string().contains("holds thesis.tex"));
        write("plain/file", "");
        assert!(check("plain").unwrap_err().to_string().contains("is no comparison"));
        assert!(check("plain/file").is_err());
    }
}
