//! Rules that every plugin has to keep, and the check of one rule for one library.
//!
//! A rule calls foreign code in ways that may end the process: a program that checks a plugin which it does
//! not trust runs each rule in a process of its own (as `simod plugin check` does), and takes the end of
//! that process for an answer.

mod answer;
mod case;
mod description;
mod finding;
mod inputs;
mod limits;
mod meaning;
mod migration;
mod parameters;
mod random;
mod subject;

use finding::Checked;
pub use finding::{Finding, Verdict};
use simod_model::{Error, Result};
use simod_session::plugins::load_unchecked;
use std::path::Path;
use subject::Subject;

/// A rule.
#[derive(Debug)]
pub struct Rule {
    /// Stable id, kebab-case.
    pub id: &'static str,
    /// Demand of the rule on a plugin.
    pub asks: &'static str,
    run: fn(&Subject) -> Checked<Finding>,
}

/// Id of the rule that is checked first: where it is broken, no other rule can be asked.
pub const LOADS: &str = "loads";

/// Id of the rule on the description, without which plugins are not used.
const DESCRIPTOR: &str = "descriptor";

/// Id of the rule on the description's texts, which can be checked of a wrong description, too.
const TEXTS: &str = "texts";

/// Id of the rule on the library's file alone.
const UNWINDS: &str = "unwinds";

/// All rules, in the order to check them.
pub const RULES: &[Rule] = &[
    Rule { id: LOADS, asks: "the library loads and describes itself", run: description::loads },
    Rule { id: DESCRIPTOR, asks: "the description makes sense", run: description::descriptor },
    Rule { id: TEXTS, asks: "what users read is lines of plain text", run: description::texts },
    Rule {
        id: UNWINDS,
        asks: "a panic is an error, and not the end of the process",
        run: |subject| Ok(description::unwinds(subject.plugin.path())),
    },
    Rule { id: "own-id", asks: "no plugin of the program has its id", run: description::own_id },
    Rule { id: "ordinary", asks: "an ordinary model is deformed by the defaults", run: meaning::ordinary },
    Rule { id: "no-samples", asks: "no sample at all does no harm", run: inputs::no_samples },
    Rule { id: "one-sample", asks: "a single sample is no problem", run: inputs::one_sample },
    Rule { id: "two-samples", asks: "nor are two", run: inputs::two_samples },
    Rule { id: "coincident", asks: "samples may lie in one point", run: inputs::coincident },
    Rule { id: "collinear", asks: "samples may lie on a line", run: inputs::collinear },
    Rule { id: "flat", asks: "samples may lie in a plane", run: inputs::flat },
    Rule { id: "not-a-number", asks: "nor does one that is no number", run: inputs::not_a_number },
    Rule { id: "large", asks: "there may be 200 000 samples", run: inputs::large },
    Rule {
        id: "huge-coordinates",
        asks: "samples may lie far outside the box",
        run: inputs::huge_coordinates,
    },
    Rule { id: "regions-empty", asks: "regions may hold no sample", run: inputs::regions_empty },
    Rule {
        id: "regions-contradictory",
        asks: "a sample may be fixed and moved at once",
        run: inputs::regions_contradictory,
    },
    Rule { id: "identity", asks: "handles that do not move leave all as it is", run: meaning::identity },
    Rule { id: "rigid", asks: "what moves as a whole moves rigidly", run: meaning::rigid },
    Rule { id: "repeatable", asks: "the same input gives the same bytes", run: meaning::repeatable },
    Rule { id: "input-unchanged", asks: "the input is left as it is", run: meaning::input_unchanged },
    Rule { id: "evaluate", asks: "the map of space agrees with the samples", run: meaning::evaluate },
    Rule { id: "handles", asks: "handles that it places make sense", run: meaning::handles },
    Rule { id: "is-identity", asks: "it tells the truth on doing nothing", run: meaning::is_identity },
    Rule { id: "migration", asks: "older sessions keep working", run: migration::migration },
    Rule { id: "time", asks: "any time of a sequence is no trouble", run: meaning::time },
    Rule { id: "attributes", asks: "models with any attributes are no trouble", run: meaning::attributes },
    Rule { id: "other-models", asks: "any other model is no trouble", run: meaning::other_models },
    Rule { id: "bounds", asks: "parameters may take any value in range", run: parameters::bounds },
    Rule {
        id: "invalidation",
        asks: "what does not invalidate the preparation does not matter to it",
        run: parameters::invalidation,
    },
    Rule { id: "cancel", asks: "it stops when it is asked to", run: limits::cancel },
    Rule { id: "log", asks: "it does not talk all the time", run: limits::log },
    Rule { id: "latency", asks: "it deforms at an interactive rate", run: limits::latency },
];

/// The rule of an id.
pub fn rule(id: &str) -> Result<&'static Rule> {
    RULES.iter().find(|rule| rule.id == id).ok_or_else(|| {
        let ids = RULES.iter().map(|rule| rule.id);
        let hint = match simod_session::params::nearest(id, ids.clone()) {
            Some(near) => format!("did you mean `{near}`?"),
            None => format!("there are {}", ids.collect::<Vec<_>>().join(", ")),
        };
        Error::argument(format!("there is no rule `{id}`"), hint)
    })
}

/// Checks a library against one rule. `seed` determines all that is random.
///
/// The library stays loaded, and its effects on this process are unknown.
pub fn check_rule(file: &Path, rule: &Rule, seed: u64) -> Finding {
    if rule.id == UNWINDS {
        // The rule does not run the library.
        return description::unwinds(file);
    }
    let plugin = match load_unchecked(file) {
        Ok(plugin) => plugin,
        Err(error) => return Finding::fail(error.to_string(), error.hint()),
    };
    let subject = Subject::new(plugin, seed);
    if ![LOADS, DESCRIPTOR, TEXTS].contains(&rule.id) && description::is_wrong(&subject) {
        return Finding::skip(format!("its description is wrong: see the rule `{DESCRIPTOR}`"));
    }
    (rule.run)(&subject).unwrap_or_else(|finding| finding)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_unique_and_kebab_case() {
        for (i, rule) in RULES.iter().enumerate() {
            assert!(simod_session::params::is_id(rule.id), "{}", rule.id);
            assert!(RULES[..i].iter().all(|other| other.id != rule.id), "{}", rule.id);
        }
        assert!(rule("identiy").unwrap_err().hint().contains("`identity`"));
    }

    #[test]
    fn what_is_no_library_fails() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let finding = check_rule(file.path(), rule(LOADS).unwrap(), 0);
        assert_eq!(finding.verdict, Verdict::Fail);
        assert!(!finding.hint.is_empty());
    }
}
