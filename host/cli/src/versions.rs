//! The versions of a command line that names several deformed samples and outputs at once.

use std::path::{Component, Path, PathBuf};

use simod_model::{Error, Result, matching};

/// Placeholder in an output's name for the part that tells the versions apart.
const PLACE: &str = "{}";

/// Deformed samples, the model to write, and the diagnostics, if they are asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VersionPaths {
    pub deformed: PathBuf,
    pub output: PathBuf,
    pub diagnostics: Option<PathBuf>,
}

/// All versions that `deformed`, files or patterns, and `output` and `diagnostics` speak of; those of a
/// pattern in natural order.
///
/// # Errors
/// A pattern matches no file; two files to write would be the same, or one is one of the deformed files.
pub fn versions(
    deformed: &[PathBuf],
    output: &Path,
    diagnostics: Option<&Path>,
) -> Result<Vec<VersionPaths>> {
    let mut versions: Vec<VersionPaths> = Vec::new();
    for named in deformed {
        for (deformed, name) in files(named)? {
            let named = |target: &Path| match target.to_str() {
                Some(text) => PathBuf::from(text.replace(PLACE, &name)),
                None => target.to_owned(),
            };
            let (output, diagnostics) = (named(output), diagnostics.map(named));
            versions.push(VersionPaths { deformed, output, diagnostics });
        }
    }
    let is_one = |target: &&Path| !target.to_str().is_some_and(|text| text.contains(PLACE));
    if let Some(target) = [output].into_iter().chain(diagnostics).find(is_one).filter(|_| versions.len() > 1)
    {
        return Err(Error::argument(
            format!("{} versions of the model cannot all be written to {}", versions.len(), target.display()),
            "put {} where they differ, as in -o 'out-{}.ply': it stands for what the * of --deformed matched",
        ));
    }
    for (i, version) in versions.iter().enumerate() {
        if let Some(other) = versions[..i].iter().find(|v| v.output == version.output) {
            return Err(Error::argument(
                format!(
                    "{} and {} would both be written to {}",
                    other.deformed.display(),
                    version.deformed.display(),
                    version.output.display()
                ),
                "name each file once, and let {} in -o stand for what differs",
            ));
        }
        let targets = || [&version.output].into_iter().chain(&version.diagnostics);
        let is_output = |v: &&VersionPaths| targets().any(|target| is_same_file(&v.deformed, target));
        if let Some(read) = versions.iter().find(is_output) {
            return Err(Error::argument(
                format!("{} is one of the deformed files", read.deformed.display()),
                "write to another file",
            ));
        }
    }
    Ok(versions)
}

/// Files that a path or a pattern means, each with the text for `{}`: the text that the only `*` of the
/// pattern matched, and otherwise the file's name without its ending.
fn files(named: &Path) -> Result<Vec<(PathBuf, String)>> {
    let stem = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let Some(paths) = matching(named)? else {
        // A missing file is reported when it is read.
        return Ok(vec![(named.to_owned(), stem(named))]);
    };
    let name = |path: &Path| matched(named, path).unwrap_or_else(|| stem(path));
    Ok(paths.into_iter().map(|path| (path.clone(), name(&path))).collect())
}

/// Text for which the only wildcard of a pattern, a `*`, stands in a path that the pattern matches.
fn matched(pattern: &Path, path: &Path) -> Option<String> {
    let text = pattern.to_str()?;
    if text.matches('*').count() != 1 || text.contains(['?', '[']) {
        return None;
    }
    // Components are compared from the end, as a leading "./" may be missing in the path.
    let mut pairs = pattern.components().rev().zip(path.components().rev());
    pairs.find_map(|(pattern, found)| {
        let (Component::Normal(pattern), Component::Normal(found)) = (pattern, found) else { return None };
        let (before, after) = pattern.to_str()?.split_once('*')?;
        Some(found.to_str()?.strip_prefix(before)?.strip_suffix(after)?.to_owned())
    })
}

fn is_same_file(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_star_is_what_it_matched() {
        let matched = |pattern: &str, path: &str| matched(Path::new(pattern), Path::new(path));
        assert_eq!(matched("frame-*.ply", "frame-07.ply").as_deref(), Some("07"));
        assert_eq!(matched("./frame-*", "frame-").as_deref(), Some(""));
        assert_eq!(matched("/a/*/d.ply", "/a/b c/d.ply").as_deref(), Some("b c"));
        assert_eq!(matched("*-*.ply", "a-b.ply"), None);
        assert_eq!(matched("frame-?.ply", "frame-1.ply"), None);
    }

    #[test]
    fn patterns_and_files_become_versions() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["f-10.ply", "f-2.ply", "f-.ply", "g.ply", ".f-3.ply"] {
            std::fs::File::create(at(name)).unwrap();
        }
        std::fs::create_dir(at("f-4.ply")).unwrap();
        let outputs = |deformed: &[&str], output: &str| -> Result<Vec<PathBuf>> {
            let deformed: Vec<PathBuf> = deformed.iter().map(|d| at(d)).collect();
            Ok(versions(&deformed, &at(output), None)?.into_iter().map(|v| v.output).collect())
        };
        let error = |deformed: &[&str], output: &str| outputs(deformed, output).unwrap_err().to_string();
        assert_eq!(outputs(&["f-*.ply"], "o-{}").unwrap(), [at("o-"), at("o-2"), at("o-10")]);
        assert_eq!(outputs(&["f-2.ply", "g.ply"], "o-{}").unwrap(), [at("o-f-2"), at("o-g")]);
        assert_eq!(outputs(&["g*"], "o").unwrap(), [at("o")]);
        assert_eq!(outputs(&["missing.ply"], "{}.o").unwrap(), [at("missing.o")]);
        assert!(error(&["h*"], "o").ends_with("h* matches no file"));
        assert!(error(&["f***"], "o").contains("is no pattern"));
        assert!(error(&["f-*.ply"], "o").starts_with("3 versions of the model cannot all be written to"));
        let twice = error(&["f-*.ply", "f-2.ply", "g.ply", "g.ply"], "o-{}");
        assert!(twice.contains("g.ply and ") && twice.ends_with("o-g"), "{twice}");
        assert!(error(&["f-*.ply"], "f-{}.ply").ends_with("f-.ply is one of the deformed files"));
        // A file of that very name is meant.
        std::fs::File::create(at("f-[2].ply")).unwrap();
        assert_eq!(outputs(&["f-[2].ply"], "{}").unwrap(), [at("f-[2]")]);
    }
}
