//! What steps and their plugins say, in the window's words: they speak of session files, which users of the window
//! may never have seen.

use simod_session::Plugin;

/// Tables of a step in a session file, and what the window has for them.
const TABLES: [(&str, &str); 4] =
    [("joint", "joints"), ("handle", "handles"), ("region", "regions"), ("stroke", "strokes")];

/// A text as the window says it. Parameters of the plugin have the names that its panel shows.
pub fn in_window(text: &str, plugin: Option<&Plugin>) -> String {
    // Which plugin it is stands above.
    let named = plugin.and_then(|plugin| text.strip_prefix(&format!("plugin {}: ", plugin.id())));
    let mut text = named.unwrap_or(text).to_owned();
    for role in ["handle", "fixed", "mask"] {
        let told = format!("add a [[step.region]] with role = \"{role}\"");
        let article = if role == "handle" { "a handle" } else { &*format!("a {role} region") };
        text = text.replace(&told, &format!("select samples, and make {article} of them"));
    }
    for (table, name) in TABLES {
        text = text.replace(&format!("the [[step.{table}]]"), &format!("its {name}"));
        let tool = if table == "joint" { " (with the tool for them: J)" } else { "" };
        text = text.replace(&format!("some by [[step.{table}]]"), &format!("some {name}{tool}"));
        text = text.replace(&format!("[[step.{table}]]"), name);
    }
    for param in plugin.into_iter().flat_map(|plugin| plugin.params()) {
        text = text.replace(&format!("`{}`", param.id), &format!("\u{201c}{}\u{201d}", param.name));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::in_window;

    #[test]
    fn nobody_reads_of_tables() {
        let told = |text: &str| in_window(text, None);
        assert_eq!(
            told("add a [[step.region]] with role = \"handle\""),
            "select samples, and make a handle of them"
        );
        assert_eq!(told("remove the [[step.stroke]]"), "remove its strokes");
        let joints = told("place some by [[step.joint]], or give a file with a skeleton as `skeleton`");
        assert!(joints.starts_with("place some joints (") && !joints.contains("[["), "{joints}");
        assert_eq!(told("nothing of the kind"), "nothing of the kind");
    }
}
