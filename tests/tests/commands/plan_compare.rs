//! `simod compare --plan` and `simod unit`: a comparison by units.

use serde_json::Value;
use simod_tests::Workplace;
#[cfg(unix)]
use simod_tests::skip;

use super::compare::HEAD;
#[cfg(unix)]
use super::plan::shell;

/// Two samplings, four methods that are done, of which one appends samples, and one that is not.
const METHODS: &str = r#"
[[method]]
name = "as rigid as possible"
deform = "laplacian"
[[method]]
name = "rbf, coarse"
deform = "rbf"
sampling = { samples = 500 }
reconstruction = "projected-barycentric"
[[method]]
name = "refined"
session = "edit.toml"
[[method]]
name = "given"
model = "bar.ply"
[[method]]
name = "unknown"
deform = "no-such-plugin"
"#;

const REFINED: &str = "[[step]]\ndeform = 'warp'\nparams = { operation = 'twist', angle = 60 }\n\
                       [[step]]\nrefine = { shapes = [{ sphere = { center = [0, 1, 0], radius = 0.4 } }], factor = 3 }\n";

/// The units of that: samplings, methods, and the page.
const UNITS: [&str; 8] = ["sample", "sample", "method", "method", "method", "method", "method", "page"];

fn with_comparison() -> Workplace {
    let work = Workplace::new();
    work.simod("generate --shape bar --vertices 12000 -o bar.ply");
    work.write_session("bar.ply", 2000, REFINED);
    work.write("compare.toml", format!("{HEAD}{METHODS}"));
    work
}

/// The figures, without what two runs do not have in common.
fn steady(work: &Workplace, folder: &str) -> Value {
    let mut record: Value =
        serde_json::from_slice(&work.read(&format!("{folder}/compare.json"))).expect("JSON");
    for method in record["methods"].as_array_mut().expect("methods") {
        if let Some(figures) = method["figures"].as_object_mut() {
            assert!(figures.remove("seconds").is_some() && figures.remove("peak_memory_bytes").is_some());
        }
    }
    record
}

fn names(work: &Workplace, folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(work.path(folder)).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("an entry").file_name().into_string().expect("UTF-8")).collect();
    names.sort();
    names
}

/// All that two comparisons have to have in common.
fn assert_same(work: &Workplace, one: &str, other: &str) {
    assert_eq!(steady(work, one), steady(work, other));
    assert_eq!(names(work, one), names(work, other));
    for name in names(work, one).iter().filter(|name| name.ends_with(".png") || name.ends_with(".ply")) {
        assert_eq!(work.read(&format!("{one}/{name}")), work.read(&format!("{other}/{name}")), "{name}");
    }
}

#[test]
fn a_comparison_by_units_is_that_of_one_process() {
    let work = with_comparison();
    for keep in ["", " --keep-models"] {
        work.simod(&format!("compare compare.toml -o expected{keep}"));
        let report = work.report(&format!("compare compare.toml -o out --plan plan{keep}"));
        assert_eq!((report["units"].as_u64(), report["methods"].as_u64()), (Some(8), Some(5)));
        // The samplings, and the methods in an order of their own.
        for (unit, was_done) in
            [1, 0, 5, 3, 6, 2, 4, 3, 7, 7].into_iter().zip([false; 7].into_iter().chain([true, false, true]))
        {
            let report = work.report(&format!("unit plan {unit}"));
            assert_eq!(report["stage"], UNITS[unit]);
            assert_eq!(report["was_done"], was_done, "unit {unit}");
        }
        assert_same(&work, "expected", "out");
        assert_eq!(names(&work, "out").contains(&"refined.ply".to_owned()), !keep.is_empty());
        let left = ["sampled-0.json", "sampled-0.simod", "sampled-1.json", "sampled-1.simod"];
        assert_eq!(names(&work, "plan"), [&["finished.toml", "plan.toml"][..], &left].concat());
    }
    // Remains of a killed process go as the last unit is done again.
    let tidied = names(&work, "plan");
    work.write("plan/.simod-sampled-0.simod.part", "");
    work.write("plan/method-2/compare.json", "");
    work.simod("unit plan 7");
    assert_eq!(names(&work, "plan"), tidied);
    let done = work.report("unit plan 4");
    assert_eq!(done["was_done"], true, "what was removed is not done again");
}

#[test]
#[cfg(unix)]
fn an_engine_does_the_units_of_a_comparison() {
    if std::process::Command::new("make").arg("--version").output().is_err() {
        return skip("there is no make");
    }
    let work = with_comparison();
    work.simod("compare compare.toml -o expected");
    work.simod("compare compare.toml -o out --plan plan --emit make,slurm,commands");
    shell(&work, "make -s -C plan -j 3");
    assert_same(&work, "expected", "out");
    // Again, nothing is to be done, though the methods' folders are gone.
    shell(&work, "make -q -C plan");
    let text = |name: &str| String::from_utf8(work.read(&format!("plan/{name}"))).expect("UTF-8");
    assert!(text("slurm.sh").contains("submit method --dependency=\"afterok:${job0}\" --array=2-6"));
    assert_eq!(text("commands.txt").lines().filter(|line| !line.starts_with('#')).count(), UNITS.len());
}

#[test]
fn units_of_a_comparison_refuse_what_is_not_as_it_was_planned() {
    let work = with_comparison();
    work.simod("compare compare.toml -o out --plan plan");
    work.refuses("unit plan 2", &["unit 0 (sample) has to be done before unit 2"]);
    work.refuses("unit plan 7", &["unit 2 (method) has to be done before unit 7"]);
    work.refuses("unit plan 8", &["has no unit 8"]);
    work.simod("unit plan 0");
    // A session that a method does, and then the file itself.
    work.write("edit.toml", String::from_utf8(work.read("edit.toml")).expect("UTF-8") + "# more\n");
    work.refuses("unit plan 4", &["edit.toml changed since the plan was made"]);
    work.write("compare.toml", format!("{HEAD}{METHODS}# more\n"));
    work.refuses("unit plan 2", &["compare.toml changed since the plan was made"]);
    assert!(!work.path("out").exists());

    // Programs are run by who was allowed to plan them, and no other ones later on.
    let program = "[[method]]\nname = 'program'\ncommand = 'cp {samples} {output}'\n";
    let command = format!("{HEAD}{METHODS}{program}");
    work.write("compare.toml", &command);
    work.refuses("compare compare.toml -o out --plan plan", &["runs a program: cp"]);
    work.simod("compare compare.toml -o out --plan plan --allow-commands");
    let plan = String::from_utf8(work.read("plan/plan.toml")).expect("UTF-8");
    work.write("plan/plan.toml", plan.replace("allow-commands = true", "allow-commands = false"));
    work.refuses("unit plan 0", &["runs a program: cp"]);
    work.write("plan/plan.toml", plan);
    work.write("compare.toml", command.replace("cp {", "mv {"));
    work.refuses("unit plan 1", &["compare.toml changed since the plan was made"]);
}

#[test]
fn a_plan_and_its_comparison_do_not_lie_in_each_other() {
    let work = with_comparison();
    work.refuses("compare compare.toml -o out --plan out", &["lie in each other"]);
    work.simod("compare compare.toml -o out");
    work.refuses("compare compare.toml -o out --plan out/plan", &["lie in each other"]);
    work.simod("compare compare.toml -o other --plan plan");
    work.refuses("compare compare.toml -o plan/out --plan plan", &["lie in each other"]);
    work.write("note.txt", "");
    work.refuses("compare compare.toml -o out --plan note.txt", &["is no plan"]);
}

/// A disk that is full is none of the method's failures: the unit is done again, by a machine that has room.
#[test]
#[cfg(unix)]
fn a_full_disk_is_no_failure_of_a_method() {
    let work = with_comparison();
    work.simod("compare compare.toml -o expected");
    work.simod("compare compare.toml -o out --plan plan");
    work.simod("unit plan 0");
    work.refuses_beyond(50_000, "unit plan 2", &["cannot write", "method-0"]);
    for unit in 1..UNITS.len() {
        work.simod(&format!("unit plan {unit}"));
    }
    assert_same(&work, "expected", "out");
}
