//! A path that is typed, where the system has no dialogs for files.

use crate::dialogs::Purpose;
use std::path::{MAIN_SEPARATOR, Path, PathBuf};

/// Most files that are offered.
const OFFERED: usize = 200;

/// A path that is being typed.
pub struct Prompt {
    /// The purpose of the path.
    pub purpose: Purpose,
    /// Text so far.
    pub text: String,
    /// Reason why the path is typed instead of chosen.
    pub why: String,
    /// Defect of the typed path, in words.
    pub wrong: Option<String>,
    /// Folder that was looked into last, with its content.
    listed: Option<(PathBuf, Vec<String>)>,
    /// The part of the text that is selected next, if any is.
    pub select: Option<[usize; 2]>,
}

impl Prompt {
    /// Prompt that begins with a path, which is selected.
    pub fn new(purpose: Purpose, at: Option<&Path>, why: &str) -> Self {
        let text = at.map_or_else(String::new, |path| path.display().to_string());
        let select = Some([0, text.chars().count()]);
        Self { purpose, text, why: why.to_owned(), wrong: None, listed: None, select }
    }

    /// Path that is typed so far.
    pub fn path(&self) -> PathBuf {
        at_home(self.text.trim())
    }

    /// Names in the typed folder that begin as the last name does; folders end with a separator.
    pub fn completions(&mut self) -> Vec<String> {
        let (folder, begun) = parts(&self.text);
        let looked = if folder.is_empty() { PathBuf::from(".") } else { at_home(folder) };
        if self.listed.as_ref().is_none_or(|(known, _)| *known != looked) {
            self.listed = Some((looked.clone(), listing(&looked, &self.purpose)));
        }
        let all = self.listed.iter().flat_map(|(_, names)| names);
        let fits =
            |name: &&String| name.starts_with(begun) && (begun.starts_with('.') || !name.starts_with('.'));
        all.filter(fits).take(OFFERED).cloned().collect()
    }

    /// Completes the text with a name.
    pub fn complete(&mut self, name: &str) {
        let (folder, _) = parts(&self.text);
        self.text = format!("{folder}{name}");
        let end = self.text.chars().count();
        (self.select, self.wrong) = (Some([end, end]), None);
    }

    /// Defect of the path, in words, if it has any.
    pub fn defect(&self) -> Option<String> {
        let path = self.path();
        if self.text.trim().is_empty() {
            return Some("Type a path.".to_owned());
        }
        if !self.purpose.makes() {
            return (!path.exists()).then(|| format!("There is no {}.", path.display()));
        }
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        match folder.filter(|folder| !folder.is_dir()) {
            Some(folder) => Some(format!("There is no folder {}.", folder.display())),
            None if self.purpose != Purpose::Turntable && path.is_dir() => {
                Some(format!("{} is a folder: type the name of a file.", path.display()))
            }
            None => None,
        }
    }
}

/// Text up to the last separator, and the rest.
fn parts(text: &str) -> (&str, &str) {
    text.split_at(text.rfind(['/', MAIN_SEPARATOR]).map_or(0, |at| at + 1))
}

/// A path whose `~` is the user's folder.
fn at_home(text: &str) -> PathBuf {
    let rest =
        text.strip_prefix('~').filter(|rest| rest.is_empty() || rest.starts_with(['/', MAIN_SEPARATOR]));
    match (rest, directories::UserDirs::new()) {
        (Some(rest), Some(user)) => user.home_dir().join(rest.trim_start_matches(['/', MAIN_SEPARATOR])),
        _ => PathBuf::from(text),
    }
}

/// Folders, and files that are of use, by their names.
fn listing(folder: &Path, purpose: &Purpose) -> Vec<String> {
    let extensions = purpose.extensions();
    let is_of_use = |path: &Path| {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        extensions.is_empty() || extension.is_some_and(|e| extensions.contains(&&*e))
    };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let name = |entry: std::fs::DirEntry| {
        let (path, name) = (entry.path(), entry.file_name().into_string().ok()?);
        if path.is_dir() {
            return Some(format!("{name}{MAIN_SEPARATOR}"));
        }
        (*purpose != Purpose::OpenFolder && is_of_use(&path)).then_some(name)
    };
    let mut names: Vec<String> = entries.filter_map(name).collect();
    names.sort_by_key(|name| name.to_lowercase());
    names
}

/// The longest beginning of all names.
pub fn common(names: &[String]) -> Option<String> {
    let first = names.first()?;
    let is_common = |end: usize| names.iter().all(|name| name.starts_with(&first[..end]));
    let ends = first.char_indices().map(|(at, c)| at + c.len_utf8()).take_while(|end| is_common(*end));
    ends.last().map(|end| first[..end].to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_go_on_with_what_is_there() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["lion-a.ply", "lion-b.ply", "notes.txt", ".hidden.ply"] {
            std::fs::File::create(folder.path().join(name)).unwrap();
        }
        std::fs::create_dir(folder.path().join("lions")).unwrap();
        let at = folder.path().join("l");
        let mut prompt = Prompt::new(Purpose::Open, Some(&at), "");
        let inside = format!("lions{MAIN_SEPARATOR}");
        let names = prompt.completions();
        assert_eq!(names, ["lion-a.ply", "lion-b.ply", &inside]);
        prompt.complete(&common(&names).unwrap());
        assert_eq!(prompt.path(), folder.path().join("lion"));
        prompt.text.push_str("-b");
        assert_eq!(prompt.completions(), ["lion-b.ply"]);
        assert!(prompt.defect().unwrap().contains("There is no"));
        prompt.complete("lion-b.ply");
        assert_eq!(prompt.defect(), None);
        let hidden = Prompt::new(Purpose::Open, Some(&folder.path().join(".h")), "").completions();
        assert_eq!(hidden, [".hidden.ply"]);
        // A file that is to be made need not be there, but its folder.
        let made = |name: &str| Prompt::new(Purpose::Save, Some(&folder.path().join(name)), "").defect();
        assert!(made("new.toml").is_none() && made("nowhere/new.toml").is_some() && made("lions").is_some());
    }
}
