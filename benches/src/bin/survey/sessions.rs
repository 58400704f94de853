//! The sessions of the cases: some as they are, some with another tool on the same regions.

use std::fs;
use std::path::{Path, PathBuf};

use simod_benches::process::Result;
use simod_model::output::write_file;
use toml::{Table, Value};

use crate::cases::{Case, Method};

/// Copies a folder's files, so that sessions find models beside them.
pub fn copy(from: &Path, to: &Path) -> Result<()> {
    for entry in fs::read_dir(from).map_err(|e| format!("{}: {e}", from.display()))? {
        let path = entry?.path();
        if let (true, Some(name)) = (path.is_file(), path.file_name()) {
            fs::copy(&path, to.join(name))?;
        }
    }
    Ok(())
}

/// The session of a tool for a case, or none where the tool cannot do it.
pub fn find(folder: &Path, case: &Case, method: &Method) -> Result<Option<PathBuf>> {
    let own = folder.join(format!("{}-{}.toml", case.name, method.key));
    let Some([deform, params]) = method.by_regions else {
        return Ok(own.is_file().then_some(own));
    };
    let text = fs::read_to_string(folder.join(format!("{}.toml", case.name)))?;
    write_file(&own, with_tool(&text, deform, params)?.as_bytes())?;
    Ok(Some(own))
}

/// A session of one step, with another tool.
fn with_tool(session: &str, deform: &str, params: &str) -> Result<String> {
    let mut session: Table = toml::from_str(session)?;
    let steps = session.get_mut("step").and_then(Value::as_array_mut);
    let Some([Value::Table(step)]) = steps.map(Vec::as_mut_slice) else {
        return Err("a case's session has one step".into());
    };
    step.insert("deform".to_owned(), Value::from(deform));
    step.insert("params".to_owned(), Value::Table(toml::from_str(params)?));
    Ok(toml::to_string(&session)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tool_takes_the_place_of_another_and_keeps_the_regions() {
        let text = "[[step]]\ndeform = 'warp'\nparams = { angle = 3 }\n[[step.region]]\nrole = 'fixed'\n";
        let changed = with_tool(text, "laplacian", "mode = 'arap'").unwrap();
        let changed: Table = toml::from_str(&changed).unwrap();
        let expected =
            "[[step]]\ndeform = 'laplacian'\nparams = { mode = 'arap' }\n[[step.region]]\nrole = 'fixed'\n";
        assert_eq!(changed, toml::from_str(expected).unwrap());
        assert!(with_tool("[model]\npath = 'a'\n", "rbf", "").is_err());
    }
}
