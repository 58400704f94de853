//! `simod plugin check`: a plugin's library against all rules, each in a process of its own, so that a plugin
//! that crashes or never ends breaks one rule and not the program.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use clap::Args;
use serde_json::{Value, json};
use simod_check::{Finding, RULES, Rule, Verdict};
use simod_model::{Error, Progress, Result, input};

use super::plugin_options::{PluginArgs, parse_seconds};
use super::sample::parse_bytes;
use crate::report::Report;
use simod_session::child::{self, End};

/// Check that a plugin keeps the rules: edge cases, crashes, hangs, wrong results
#[derive(Args)]
pub struct Check {
    /// File of a library, or id of a plugin that is found
    plugin: String,
    /// Id of a rule to check, instead of all (may be given several times)
    #[arg(long, value_name = "ID", value_parser = parse_rule)]
    rule: Vec<&'static Rule>,
    /// Seed of all that is random: the same one checks the same
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Time that a rule may take, in seconds
    #[arg(long, value_name = "SECONDS", default_value = "60", value_parser = parse_seconds)]
    time_limit: Duration,
    /// Memory that a rule may take, as 4G (on Linux)
    #[arg(long, value_name = "SIZE", default_value = "4G", value_parser = parse_bytes)]
    memory_limit: u64,
}

/// Check one rule in this very process
#[derive(Args)]
#[command(hide = true)]
pub struct CheckRule {
    /// Library of the plugin
    file: PathBuf,
    /// Id of the rule
    #[arg(value_parser = parse_rule)]
    rule: &'static Rule,
    /// Seed of all that is random: the same one checks the same
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Memory that this process may take (on Linux)
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes)]
    memory_limit: Option<u64>,
    /// Number of the process that started this one, which ends with it
    #[arg(long, value_name = "N")]
    parent: Option<u32>,
}

fn parse_rule(id: &str) -> std::result::Result<&'static Rule, String> {
    simod_check::rule(id).map_err(|e| format!("{e}: {}", e.hint()))
}

/// Result of a rule.
struct RuleResult {
    rule: &'static Rule,
    finding: Finding,
    time: Duration,
}

impl CheckRule {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        if let Some(parent) = self.parent {
            child::end_with(parent);
        }
        if let Some(bytes) = self.memory_limit {
            child::limit_memory(bytes)?;
        }
        let finding = simod_check::check_rule(&self.file, self.rule, self.seed);
        report.line(format!("{} {}: {}", finding.verdict, self.rule.id, finding.found));
        report.figure("rule", self.rule.id);
        report.figure("finding", json!(finding));
        Ok(())
    }
}

impl Check {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let file = self.library(report)?;
        if !child::LIMITS_MEMORY {
            report.warn(
                "this system has no limit on memory: a plugin that takes all of it takes it from others",
            );
        }
        let progress = report.untimed();
        progress.begin("checking the plugin", 0);
        let mut all: Vec<RuleResult> = Vec::new();
        for rule in RULES.iter().filter(|r| self.rule.is_empty() || self.rule.iter().any(|w| w.id == r.id)) {
            let started = Instant::now();
            let useless =
                all.iter().any(|c| c.rule.id == simod_check::LOADS && c.finding.verdict == Verdict::Fail);
            let finding = if useless {
                Finding::skip("the library does not load")
            } else {
                self.check(rule, &file, progress)?
            };
            all.push(RuleResult { rule, finding, time: started.elapsed() });
        }
        self.tell(&file, &all, report);
        Ok(())
    }

    /// The file to check.
    fn library(&self, report: &mut Report) -> Result<PathBuf> {
        let path = Path::new(&self.plugin);
        if path.extension().is_none() && path.components().count() == 1 && (path.is_dir() || !path.exists()) {
            let plugins = PluginArgs::default().discover(report)?;
            let plugin = plugins.get(&self.plugin)?;
            plugins.replaced(plugin).into_iter().for_each(|notice| report.warn(notice));
            return Ok(plugin.path().to_owned());
        }
        // A pipe would be waited for, so it is refused here.
        input::open(path)?;
        // The dynamic linker would look for a bare name elsewhere.
        path.canonicalize().map_err(|e| Error::io("read", path, &e))
    }

    /// Checks one rule in a process of its own.
    fn check(&self, rule: &Rule, file: &Path, progress: &dyn Progress) -> Result<Finding> {
        let program = std::env::current_exe().map_err(|e| Error::io("find", "this program".as_ref(), &e))?;
        let mut command = Command::new(program);
        command.args(["plugin", "check-rule", "--json"]).arg(file).arg(rule.id);
        command.args(["--seed", &self.seed.to_string(), "--memory-limit", &self.memory_limit.to_string()]);
        command.args(["--parent", &std::process::id().to_string()]);
        let outcome = child::run(command, self.time_limit, progress)?;
        let because = |what: String| {
            if outcome.last_error.is_empty() { what } else { format!("{what}: {}", outcome.last_error) }
        };
        Ok(match outcome.end {
            End::Well => answer(rule, &outcome.output).unwrap_or_else(|| {
                let what = because("it ended the process without an answer".to_owned());
                Finding::fail(what, "a plugin never exits: it returns an error")
            }),
            End::TooLong => Finding::fail(
                format!("still running after {} s", self.time_limit.as_secs_f64()),
                "give it more time with --time-limit, or look where it hangs",
            ),
            End::OutOfMemory => Finding::fail(
                format!("out of memory: it took more than {} MB", self.memory_limit >> 20),
                "bound what is allocated, or give it more with --memory-limit",
            ),
            End::Badly(how) => Finding::fail(
                because(how),
                "`simod plugin check-rule FILE RULE` does it in a single process, for a debugger",
            ),
        })
    }

    fn tell(&self, file: &Path, all: &[RuleResult], report: &mut Report) {
        for RuleResult { rule, finding, .. } in all {
            report.line(format!("{:4} {:21} {}", finding.verdict, rule.id, finding.found));
            if !finding.hint.is_empty() {
                report.line(format!("     hint: {}", finding.hint));
            }
            if finding.verdict == Verdict::Fail {
                report.line(format!("     again: {}", self.again(file, rule)));
            }
        }
        let count = |verdict| all.iter().filter(|c| c.finding.verdict == verdict).count();
        let (passed, failed) = (count(Verdict::Pass), count(Verdict::Fail));
        let (warned, skipped) = (count(Verdict::Warn), count(Verdict::Skip));
        report.line(format!("{passed} passed, {failed} failed, {warned} warned, {skipped} skipped"));
        let rules = all.iter().map(|c| self.value(file, c));
        report.figure("file", file.display().to_string());
        report.figure("seed", self.seed);
        report.figure("limits_memory", child::LIMITS_MEMORY);
        report.figure("rules", rules.collect::<Vec<_>>());
        for (name, count) in
            [("passed", passed), ("failed", failed), ("warned", warned), ("skipped", skipped)]
        {
            report.figure(name, count);
        }
        if failed > 0 {
            let failed = all.iter().filter(|c| c.finding.verdict == Verdict::Fail).map(|c| c.rule.id);
            let failed = failed.collect::<Vec<_>>().join(", ");
            let what = format!("{} breaks rules: {failed}", file.display());
            let hint = "the report has a hint for each; tell the plugin's author if that is somebody else";
            report.fail(Error::plugin(what, hint));
        }
    }

    fn value(&self, file: &Path, RuleResult { rule, finding, time }: &RuleResult) -> Value {
        json!({
            "rule": rule.id, "asks": rule.asks, "verdict": finding.verdict, "found": finding.found,
            "hint": finding.hint, "again": self.again(file, rule), "seconds": time.as_secs_f64(),
        })
    }

    /// Command line that checks one rule again.
    fn again(&self, file: &Path, rule: &Rule) -> String {
        format!("simod plugin check {} --rule {} --seed {}", file.display(), rule.id, self.seed)
    }
}

/// Finding that a process printed about its rule, if its last line is one. The plugin may have printed
/// before.
fn answer(rule: &Rule, output: &str) -> Option<Finding> {
    let value: Value = serde_json::from_str(output.lines().last()?).ok()?;
    if value.get("rule")? != rule.id {
        return None;
    }
    serde_json::from_value(value.get("finding")?.clone()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_the_last_line() {
        let rule = &RULES[0];
        let line = json!({"rule": rule.id, "finding": Finding::pass("fine")}).to_string();
        assert_eq!(answer(rule, &format!("noise\n{line}\n")), Some(Finding::pass("fine")));
        assert_eq!(answer(rule, ""), None);
        assert_eq!(answer(&RULES[1], &line), None);
    }

    #[test]
    fn times_are_above_nothing() {
        assert_eq!(parse_seconds("1.5"), Ok(Duration::from_millis(1500)));
        for text in ["0", "-1", "nan", "inf", "x"] {
            assert!(parse_seconds(text).is_err(), "{text}");
        }
    }
}
