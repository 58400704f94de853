//! `simod compare`: several methods on one model.

use serde_json::Value;
use simod_tests::Workplace;
#[cfg(unix)]
use simod_tests::skip;

/// Head that all of these comparisons have in common: a bar from y = 0 to y = 2.
pub const HEAD: &str = r#"
[model]
path = "bar.ply"
[sampling]
samples = 2000
[[region]]
role = "fixed"
shapes = [{ half-space = { point = [0, 0.4, 0], normal = [0, -1, 0] } }]
[[region]]
role = "handle"
shapes = [{ half-space = { point = [0, 1.6, 0], normal = [0, 1, 0] } }]
move = { translate = [0.3, 0, 0] }
[camera]
size = [120, 160]
"#;

const ARAP: &str = "[[method]]\nname = \"as rigid as possible\"\ndeform = \"laplacian\"\n";
const RBF: &str = "[[method]]\nname = \"rbf, coarse\"\ndeform = \"rbf\"\nsampling = { samples = 500 }\n\
                   reconstruction = \"projected-barycentric\"\n";

fn with_bar() -> Workplace {
    let work = Workplace::new();
    work.simod("generate --shape bar --vertices 12000 -o bar.ply");
    work
}

fn write(work: &Workplace, methods: &[&str]) {
    work.write("compare.toml", format!("{HEAD}{}", methods.concat()));
}

/// The figures, of which each number is at a path as `/pairs/0/vertices/max`.
fn record(work: &Workplace, folder: &str) -> Value {
    serde_json::from_slice(&work.read(&format!("{folder}/compare.json"))).expect("JSON")
}

fn number(record: &Value, path: &str) -> f64 {
    record.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("no number at {path}: {record}"))
}

fn names(work: &Workplace, folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(work.path(folder)).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("an entry").file_name().into_string().expect("UTF-8")).collect();
    names.sort();
    names
}

#[test]
fn two_methods_beside_each_other() {
    let work = with_bar();
    write(&work, &[ARAP, RBF]);
    let before = work.names();
    let report = work.report("compare compare.toml -o out");
    assert_eq!((report["done"].as_u64(), report["failed"].as_u64()), (Some(2), Some(0)));
    let files = [
        "as-rigid-as-possible.png",
        "compare.csv",
        "compare.json",
        "compare.tex",
        "index.html",
        "rbf-coarse-difference.png",
        "rbf-coarse.png",
        "rest.png",
    ];
    assert_eq!(names(&work, "out"), files);
    assert_eq!(work.names().len(), before.len() + 1);

    let record = record(&work, "out");
    assert_eq!(record["files"], serde_json::json!(files));
    assert_eq!(record["compare_file"].as_str().map(str::as_bytes), Some(&*work.read("compare.toml")));
    assert_eq!(record["methods"][1]["steps"][0]["plugin"], "rbf");
    assert_eq!(record["methods"][1]["steps"][0]["params"]["kernel"], "triharmonic");
    assert_eq!(record["methods"][1]["reconstruction"], "projected-barycentric");
    // The top is moved by 0.3, and nothing farther.
    let diagonal = number(&record, "/model/diagonal");
    for method in 0..2 {
        let of = |figure: &str| number(&record, &format!("/methods/{method}/figures/{figure}"));
        assert!(
            (of("displacement/max") * diagonal - 0.3).abs() < 0.01,
            "{}",
            of("displacement/max") * diagonal
        );
        assert!(of("on_samples/volume_change").abs() < 0.2);
        assert!(of("on_samples/edges/rms") > 0.01 && of("on_samples/details/folded") == 0.0);
        assert!(of("seconds/sample") > 0.0);
    }
    assert!(number(&record, "/methods/0/figures/samples") > 1500.0);
    assert!(number(&record, "/methods/1/figures/samples") < 600.0);
    // The exact map is known for one of them.
    assert!(record.pointer("/methods/0/figures/transfer_error").is_some_and(Value::is_null));
    assert!(number(&record, "/methods/1/figures/transfer_error/rms") < 1e-2);
    // Distances are told in the model's unit as well.
    for (figures, name) in [
        ("", "color_scale"),
        ("/methods/0/figures/displacement", "max"),
        ("/methods/1/figures/transfer_error", "p999"),
        ("/pairs/0/vertices", "p99"),
        ("/pairs/0/surfaces/1", "rms"),
    ] {
        let length = number(&record, &format!("{figures}/lengths/{name}"));
        assert_eq!(length, number(&record, &format!("{figures}/{name}")) * diagonal, "{figures}/{name}");
    }
    assert!(record.pointer("/methods/0/figures/on_samples/edges/lengths").is_none());
    // The record's keys come in the order in which people read it.
    let text = String::from_utf8(work.read("out/compare.json")).expect("UTF-8");
    let places =
        ["format", "model", "methods", "pairs", "files"].map(|key| text.find(&format!("\n  \"{key}\":")));
    assert!(places.is_sorted() && places.iter().all(Option::is_some), "{places:?}");
    // Vertices can slide along the surface: its distance is the smaller one.
    let [same, near] =
        ["vertices/rms", "surfaces/0/rms"].map(|of| number(&record, &format!("/pairs/0/{of}")));
    assert!(0.0 < near && near < same && same < 0.1, "{near}, {same}");
    assert!(number(&record, "/color_scale") >= number(&record, "/pairs/0/vertices/p99"));

    let page = String::from_utf8(work.read("out/index.html")).expect("UTF-8");
    assert_eq!(page.matches("src=\"data:image/png;base64,").count(), 4);
    assert!(!page.contains("<script") && !page.contains("http"), "the page needs something else");
    for tag in ["table", "tr", "th", "td", "figure", "dl", "div", "main"] {
        let opened = page.matches(&format!("<{tag}>")).count() + page.matches(&format!("<{tag} ")).count();
        assert_eq!(opened, page.matches(&format!("</{tag}>")).count(), "{tag}");
    }
}

#[test]
fn the_same_method_twice_differs_in_nothing() {
    let work = with_bar();
    let again = ARAP.replace("as rigid as possible", "again");
    write(&work, &[ARAP, &again]);
    work.simod("compare compare.toml -o out --keep-models");
    let record = record(&work, "out");
    for figure in ["vertices/rms", "vertices/max", "vertices/normals/max", "surfaces/0/max", "surfaces/1/rms"]
    {
        assert_eq!(number(&record, &format!("/pairs/0/{figure}")), 0.0, "{figure}");
    }
    assert_eq!(number(&record, "/color_scale"), 0.0);
    // The models are those of a session.
    let step = HEAD.split("[[region]]").skip(1).collect::<Vec<_>>().join("[[step.region]]");
    let step = step.split("[camera]").next().expect("a first part");
    work.write_session("bar.ply", 2000, &format!("[[step]]\ndeform = \"laplacian\"\n[[step.region]]{step}"));
    work.simod("run edit.toml");
    assert_eq!(work.read("edited.ply"), work.read("out/again.ply"));
    assert_eq!(work.read("edited.ply"), work.read("out/as-rigid-as-possible.ply"));
}

#[test]
fn a_translation_is_as_long_as_it_is() {
    let work = with_bar();
    // All of the model is the handle, and a session leaves it as it is.
    let mut text = HEAD.replace("point = [0, 1.6, 0]", "point = [0, -1, 0]");
    let (fixed, handle) = (text.find("[[region]]").expect("one"), text.rfind("[[region]]").expect("another"));
    text.replace_range(fixed..handle, "");
    let moved = "[[method]]\nname = \"moved\"\ndeform = \"smooth-handle\"\n";
    let rest = "[[method]]\nname = \"rest\"\nsession = \"rest.toml\"\n";
    work.write("compare.toml", format!("{text}{rest}{moved}"));
    work.write("rest.toml", "[[step]]\ndeform = \"warp\"\nparams = { angle = 0 }\n");
    let outcome = work.simod("compare compare.toml -o out");
    let record = record(&work, "out");
    assert!(record["methods"][1]["error"].is_null(), "{}", outcome.stderr);
    assert_eq!(record["methods"][0]["session"].as_str().map(str::as_bytes), Some(&*work.read("rest.toml")));
    let length = 0.3 / number(&record, "/model/diagonal");
    for figure in ["/pairs/0/vertices/rms", "/pairs/0/vertices/max", "/methods/1/figures/displacement/max"] {
        assert!((number(&record, figure) / length - 1.0).abs() < 1e-5, "{figure}");
    }
    // Along x: the sides that face it are as far from the others' as they moved.
    let farthest = number(&record, "/pairs/0/surfaces/0/max");
    assert!((farthest / length - 1.0).abs() < 0.02, "{farthest} instead of {length}");
    for figure in ["volume_change", "edges/max", "areas/max", "details/rms"] {
        assert!(number(&record, &format!("/methods/1/figures/on_samples/{figure}")).abs() < 1e-4, "{figure}");
    }
}

#[test]
fn a_method_that_fails_is_a_row_and_the_others_go_on() {
    let work = with_bar();
    let missing = "[[method]]\nname = \"<b>none</b>\"\ndeform = \"nonesuch\"\n";
    let wrong = "[[method]]\nname = \"wrong\"\ndeform = \"rbf\"\nparams = { tolerence = 1 }\n";
    let session = "[[method]]\nname = \"gone\"\nsession = \"gone.toml\"\n";
    write(&work, &[missing, wrong, session, ARAP]);
    let outcome = work.simod("compare compare.toml -o out --json");
    let report = outcome.json();
    assert_eq!((report["done"].as_u64(), report["failed"].as_u64()), (Some(1), Some(3)));
    assert_eq!(outcome.lines("warning: ").len(), 3, "{}", outcome.stderr);
    let record = record(&work, "out");
    let told =
        |i: usize, key: &str| record["methods"][i]["error"][key].as_str().unwrap_or_default().to_owned();
    assert!(told(0, "what").contains("nonesuch"));
    assert!(
        told(1, "what").contains("compare.toml, line ") && told(1, "hint").contains("`tolerance`"),
        "{record}"
    );
    assert!(told(2, "what").contains("gone.toml"));
    assert!(record["methods"][3]["figures"]["displacement"]["max"].as_f64().is_some_and(|d| d > 0.1));
    assert_eq!(record["pairs"], serde_json::json!([]));
    let page = String::from_utf8(work.read("out/index.html")).expect("UTF-8");
    assert!(page.contains("&lt;b&gt;none&lt;/b&gt;") && !page.contains("<b>"));
}

/// Methods with the same samples share a reading of the model; where each is run twice, each is done by
/// itself.
#[test]
fn methods_that_are_transferred_together_come_to_what_each_comes_to() {
    let work = with_bar();
    let handle = "[[method]]\nname = \"handle\"\ndeform = \"smooth-handle\"\n";
    let rest = "[[method]]\nname = \"rest\"\nsession = \"rest.toml\"\n";
    work.write("rest.toml", "[[step]]\ndeform = \"warp\"\nparams = { angle = 0 }\n");
    let methods = [handle, RBF, rest, &handle.replace("\"handle\"", "\"again\""), ARAP].concat();
    let each = format!("runs = 2\n{HEAD}{methods}");
    for (folder, text) in [("each", &each), ("together", &format!("{HEAD}{methods}"))] {
        work.write("compare.toml", text);
        let outcome = work.simod(&format!("compare compare.toml -o {folder} --keep-models"));
        let told = outcome.stderr.contains("transferring together: rest, again, as rigid as possible");
        assert_eq!(told, folder == "together", "{}", outcome.stderr);
    }
    let [each, together] = ["each", "together"].map(|folder| record(&work, folder));
    for method in 0..5 {
        let of = |record: &Value, figure: &str| {
            record.pointer(&format!("/methods/{method}/figures/{figure}")).expect("a figure").clone()
        };
        assert_eq!(of(&each, "result/repeats"), true);
        let same = ["result/hash", "transfer_error", "expected_error", "folded_samples", "displacement"];
        for figure in same {
            assert_eq!(of(&each, figure), of(&together, figure), "{method}: {figure}");
        }
    }
    assert_eq!(each["pairs"], together["pairs"]);
    for name in names(&work, "each").iter().filter(|name| name.ends_with(".ply")) {
        assert!(work.read(&format!("each/{name}")) == work.read(&format!("together/{name}")), "{name}");
    }
    // Equal parts of one time.
    let seconds =
        |method: usize| number(&together, &format!("/methods/{method}/figures/seconds/reconstruct"));
    assert_eq!(seconds(2), seconds(4));
}

#[test]
fn a_method_that_cannot_be_transferred_does_not_keep_others_from_it() {
    let work = with_bar();
    work.simod("convert bar.ply bar.las --lossy");
    let text = HEAD.replace("bar.ply", "bar.las");
    let step = "[[step]]\ndeform = \"smooth-handle\"\n[[step.region]]\nrole = \"handle\"\n\
                shapes = [{ half-space = { point = [0, -1, 0], normal = [0, 1, 0] } }]\n";
    for (name, x) in [("near", "0.1"), ("far", "1e4")] {
        work.write(&format!("{name}.toml"), format!("{step}move = {{ translate = [{x}, 0, 0] }}\n"));
    }
    let method = |name: &str| format!("[[method]]\nname = \"{name}\"\nsession = \"{name}.toml\"\n");
    work.write("compare.toml", format!("{text}{}{}", method("far"), method("near")));
    let report = work.report("compare compare.toml -o out");
    assert_eq!((report["done"].as_u64(), report["failed"].as_u64()), (Some(1), Some(1)));
    let record = record(&work, "out");
    let told = record["methods"][0]["error"]["what"].as_str().unwrap_or_default();
    assert!(told.contains("moves to x"), "{record}");
    let length = 0.1 / number(&record, "/model/diagonal");
    let moved = number(&record, "/methods/1/figures/displacement/rms");
    assert!((moved / length - 1.0).abs() < 1e-2, "{moved} instead of {length}");
}

#[test]
fn nothing_is_left_where_no_method_can_be_done() {
    let work = with_bar();
    write(&work, &["[[method]]\nname = \"a\"\ndeform = \"nonesuch\"\n"]);
    let before = work.snapshot();
    let outcome = work.run("compare compare.toml -o out");
    assert_eq!(outcome.code, Some(1), "{}", outcome.stderr);
    assert!(outcome.lines("error: ")[0].contains("nonesuch"), "{}", outcome.stderr);
    assert!(!outcome.hint().is_empty());
    assert_eq!(work.snapshot(), before);
}

#[test]
fn bad_files_and_folders_are_refused() {
    let work = with_bar();
    let refused = |text: &str, named: &[&str]| {
        work.write("bad.toml", text);
        work.refuses("compare bad.toml -o out", named);
    };
    refused("", &["bad.toml", "no model"]);
    refused(HEAD, &["bad.toml", "no method"]);
    refused(&format!("{HEAD}[[method]]\nname = \"a\"\n"), &["bad.toml, line 15", "neither"]);
    refused(&format!("{HEAD}{ARAP}{ARAP}"), &["bad.toml, line 18", "two methods"]);
    refused(&format!("runs = 0\n{HEAD}{ARAP}"), &["bad.toml, line 1", "`runs`"]);
    refused(&format!("{HEAD}{ARAP}speed = 3"), &["bad.toml, line 18", "speed"]);
    refused(&format!("{HEAD}{ARAP}").replace("bar.ply", "gone.ply"), &["gone.ply"]);
    work.refuses("compare gone.toml -o out", &["gone.toml"]);
    work.refuses("compare bar.ply -o out", &["bar.ply"]);

    write(&work, &[ARAP]);
    work.write("mine/thesis.tex", "");
    work.refuses("compare compare.toml -o mine", &["mine", "no comparison"]);
    work.refuses("compare compare.toml -o missing/out", &["missing/out"]);
    work.refuses("compare compare.toml -o bar.ply", &["bar.ply"]);
    // A former comparison is replaced, unless somebody has put something into it.
    work.simod("compare compare.toml -o out --keep-models");
    work.simod("compare compare.toml -o out");
    assert_eq!(
        names(&work, "out"),
        ["as-rigid-as-possible.png", "compare.csv", "compare.json", "compare.tex", "index.html", "rest.png"]
    );
    work.write("out/notes.txt", "");
    work.refuses("compare compare.toml -o out", &["out", "notes.txt"]);
}

/// The figures of a comparison in CSV, by the names of columns, for each method.
fn table(work: &Workplace, folder: &str) -> Vec<std::collections::BTreeMap<String, String>> {
    let text = String::from_utf8(work.read(&format!("{folder}/compare.csv"))).expect("UTF-8");
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    let names = lines.next().expect("a head");
    lines.map(|row| names.iter().cloned().zip(row).collect()).collect()
}

/// Results of other programs are compared as all others are: samples, a model, and what a program makes of
/// either.
#[cfg(unix)]
#[test]
fn what_others_made_is_a_method() {
    let work = with_bar();
    write(&work, &[ARAP]);
    work.simod("compare compare.toml -o first --keep-models");
    let step = HEAD.split("[[region]]").skip(1).collect::<Vec<_>>().join("[[step.region]]");
    let step = step.split("[camera]").next().expect("a first part");
    let step = format!("[[step]]\ndeform = \"laplacian\"\n[[step.region]]{step}");
    work.write_session("bar.ply", 2000, &step);
    work.simod("sample bar.ply -o bar.simod --samples 2000");
    work.simod("deform bar.simod --session edit.toml -o moved.ply");
    std::fs::copy(work.path("first/as-rigid-as-possible.ply"), work.path("made.ply")).expect("a copy");
    let others = [
        ("samples", "deformed = \"moved.ply\""),
        ("model", "model = \"made.ply\""),
        ("copies samples", "command = \"sh -c 'test -s {samples} && cp moved.ply {output}'\""),
        ("copies a model", "command = \"sh -c 'test -s {model} && cp made.ply {output}'\""),
        ("fails", "command = \"sh -c 'echo no such mesh >&2; exit 3' {samples} {output}\""),
        ("does nothing", "command = \"true {samples} {output}\""),
        ("rests", "command = \"cp {samples} {output}\""),
    ];
    let others: Vec<String> =
        others.iter().map(|(name, what)| format!("[[method]]\nname = \"{name}\"\n{what}\n")).collect();
    let others = others.concat();
    let crop = "[[crop]]\nname = \"Top\"\ntarget = [0, 2, 0]\npart = 0.25\n";
    work.write("compare.toml", format!("runs = 2\n{HEAD}{crop}{ARAP}{others}"));

    // A file of a stranger's runs nothing.
    let before = work.snapshot();
    work.refuses("compare compare.toml -o out", &["compare.toml, line ", "`copies samples`", "cp moved.ply"]);
    assert_eq!(work.snapshot(), before);
    let outcome = work.simod("compare compare.toml -o out --allow-commands --json");
    let report = outcome.json();
    assert_eq!(
        (report["done"].as_u64(), report["failed"].as_u64()),
        (Some(6), Some(2)),
        "{}",
        outcome.stderr
    );
    let record = record(&work, "out");
    let hash =
        |method: usize| record["methods"][method]["figures"]["result"]["hash"].as_str().map(str::to_owned);
    for method in 1..5 {
        assert!(hash(method).is_some() && hash(method) == hash(0), "{method}: {record}");
        assert_eq!(number(&record, &format!("/methods/{method}/figures/to_first/max")), 0.0);
        let arap = |of: usize| number(&record, &format!("/methods/{of}/figures/on_model/energies/arap"));
        assert!(arap(0) > 0.0 && arap(method) == arap(0));
    }
    let told = |i: usize| record["methods"][i]["error"]["what"].as_str().unwrap_or_default().to_owned();
    assert!(told(5).contains("no such mesh") && told(5).contains('3'), "{}", told(5));
    assert!(told(6).contains("wrote no {output}"), "{}", told(6));
    assert_eq!(number(&record, "/methods/7/figures/displacement/max"), 0.0);
    let energies = "/methods/7/figures/on_samples/energies";
    assert!(number(&record, &format!("{energies}/arap")) < 1e-12);
    assert!((number(&record, &format!("{energies}/symmetric_dirichlet")) - 4.0).abs() < 1e-6);

    for method in [0, 1, 3, 7] {
        let seconds = &record["methods"][method]["figures"]["seconds"];
        assert_eq!(seconds["runs"].as_array().map(Vec::len), Some(2));
        assert!(seconds["reconstruct"].as_f64() > Some(0.0) && seconds["processor"].as_f64() >= Some(0.0));
        assert_eq!(record["methods"][method]["figures"]["result"]["repeats"], true);
    }
    let times = &record["methods"][0]["figures"]["seconds"];
    let [prepare, motion, deform] =
        ["prepare", "motion", "deform"].map(|t| times["runs"][0][t].as_f64().expect("a time"));
    assert!(prepare > 0.0 && motion > 0.0 && (prepare + motion - deform).abs() < 1e-9);
    assert!(record["methods"][2]["figures"]["seconds"]["reconstruct"].is_null());
    assert!(record["methods"][2]["figures"]["on_samples"].is_null());
    assert!(number(&record, "/methods/1/figures/expected_error/rms") > 0.0);

    let table = table(&work, "out");
    assert_eq!(table.len(), 8);
    assert_eq!(table[1]["method"], "samples");
    assert_eq!(table[1]["result.hash"], hash(0).expect("a hash"));
    assert_eq!(table[2]["shape_of"], "model");
    assert!(table[5]["error"].contains("no such mesh") && table[5]["energies.arap"].is_empty());
    let arap: f64 = table[4]["energies.arap"].parse().expect("a number");
    assert!((arap - number(&record, "/methods/0/figures/on_model/energies/arap")).abs() < 1e-15);
    let latex = String::from_utf8(work.read("out/compare.tex")).expect("UTF-8");
    assert_eq!(latex.matches("\\\\").count(), 7, "{latex}");
    assert!(
        latex.contains("copies a model") && latex.contains("\\pm") && latex.contains("\\toprule"),
        "{latex}"
    );
    let failed = latex.lines().find(|line| line.starts_with("% fails could not be done: "));
    assert!(failed.is_some_and(|line| line.contains("no such mesh")), "{latex}");
    // The model that the user has stays where it is, and the crops have pictures.
    assert!(work.path("made.ply").exists());
    for name in ["rest_top.png", "samples_top.png", "samples-difference_top.png", "rest.png"] {
        assert!(work.path(&format!("out/{name}")).exists(), "{name}");
    }
    assert_ne!(work.read("out/rest.png"), work.read("out/rest_top.png"));
    let page = String::from_utf8(work.read("out/index.html")).expect("UTF-8");
    assert!(page.contains("Top, 25 % of the width") && page.contains("Energies"), "the page lacks a part");
}

/// Models with more vertices than pictures show are drawn by some of these, which look the same.
#[test]
fn pictures_of_many_vertices_are_those_of_all() {
    let work = Workplace::new();
    work.simod("generate --shape bar --vertices 150000 -o bar.ply");
    let head = |size: &str| HEAD.replace("size = [120, 160]", size);
    for (name, size) in [("few", "size = [120, 160]"), ("all", "size = [480, 640]")] {
        work.write("compare.toml", format!("{}{ARAP}{RBF}", head(size)));
        work.simod(&format!("compare compare.toml -o {name}"));
    }
    let [few, all] = ["few", "all"].map(|name| record(&work, name));
    for path in ["/pairs/0/vertices/rms", "/methods/1/figures/displacement/p99", "/color_scale"] {
        assert_eq!(number(&few, path), number(&all, path), "{path}");
    }
    let pixels = |name: &str| {
        let png = png::Decoder::new(std::io::Cursor::new(work.read(name)));
        let mut reader = png.read_info().expect("a picture");
        let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
        let info = reader.next_frame(&mut pixels).expect("pixels");
        (pixels, info.width as usize)
    };
    for name in ["rest.png", "as-rigid-as-possible.png", "rbf-coarse.png"] {
        let ((few, width), (all, _)) = (pixels(&format!("few/{name}")), pixels(&format!("all/{name}")));
        // A pixel of the one is sixteen of the other.
        let block = |x: usize, y: usize, c: usize| {
            let place = |i: usize| 3 * ((4 * y + i / 4) * 4 * width + 4 * x + i % 4) + c;
            (0..16).map(|i| f64::from(all[place(i)])).sum::<f64>() / 16.0
        };
        let mut sum = 0.0;
        for (i, pixel) in few.chunks_exact(3).enumerate() {
            for (c, value) in pixel.iter().enumerate() {
                sum += (f64::from(*value) - block(i % width, i / width, c)).abs();
            }
        }
        let mean = sum / few.len() as f64;
        assert!(mean < 3.0, "{name} differs by {mean} of 255");
    }
}

/// Without what a clock or the system tells.
fn timeless(mut record: Value) -> Value {
    let machine = record["machine"].take();
    assert!(machine["threads"].as_u64() > Some(0) && machine.get("processor").is_some(), "{machine}");
    for method in record["methods"].as_array_mut().expect("methods") {
        let figures = method["figures"].as_object_mut().expect("figures");
        assert!(figures.remove("seconds").is_some() && figures.remove("peak_memory_bytes").is_some());
    }
    record
}

#[test]
fn two_runs_differ_in_times_and_memory_alone() {
    let work = with_bar();
    write(&work, &[ARAP, RBF]);
    work.simod("compare compare.toml -o first");
    work.simod("compare compare.toml -o second --threads 1");
    assert_eq!(timeless(record(&work, "first")), timeless(record(&work, "second")));
    for name in names(&work, "first").into_iter().filter(|name| name.ends_with(".png")) {
        assert_eq!(work.read(&format!("first/{name}")), work.read(&format!("second/{name}")), "{name}");
    }
}

#[cfg(unix)]
#[test]
fn an_interrupted_comparison_leaves_nothing() {
    use std::process::{Command, Stdio};
    use std::time::Duration;

    let work = Workplace::new();
    work.simod("generate --shape bar --vertices 600000 -o bar.ply");
    write(&work, &[ARAP, RBF]);
    let before = work.snapshot();
    let mut interrupted = 0;
    for wait in [300, 900, 1800, 3000].map(Duration::from_millis) {
        let mut command = work.command("compare compare.toml -o out");
        let child =
            command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
        std::thread::sleep(wait);
        let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill runs");
        assert!(sent.success());
        let outcome = simod_tests::Outcome::from(child.wait_with_output().expect("an end"));
        if outcome.code == Some(0) {
            // The comparison was done before the signal came.
            std::fs::remove_dir_all(work.path("out")).expect("a folder");
            continue;
        }
        interrupted += usize::from(outcome.code == Some(130));
        assert_eq!(work.snapshot(), before, "after {wait:?}: {}", outcome.stderr);
    }
    if interrupted == 0 {
        skip("every comparison was done before it could be interrupted");
    }
}
