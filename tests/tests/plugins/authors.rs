//! Services of the host for third parties' plugins, through both doors, in this process and in others:
//! samples and surfaces to be looked up, the time, and older sessions that keep working.
#![cfg(unix)]

use std::env::consts::DLL_SUFFIX;

use glam::DVec3;
use serde_json::Value;
use simod_tests::{Outcome, Workplace, library};

/// The plugin in Rust and in C, and where it can run.
const IDS: [&str; 2] = ["surveyor", "surveyor-in-c"];
const PLACES: [&str; 2] = ["never", "always"];

fn workplace() -> Workplace {
    let work = Workplace::new().with_plugins("plugins");
    work.build_c("tests/c/surveyor.c", "in_c", &[]);
    work.write(
        &format!("plugins/surveyor{DLL_SUFFIX}"),
        std::fs::read(library("surveyor")).expect("a library"),
    );
    work.simod("generate -o model.ply --shape bumpy-sphere --vertices 5000");
    work.simod("sample model.ply -o model.simod --samples 500");
    work
}

/// Deforms by a step, through both doors and in both places, which all give the same bytes: the result.
fn deformed(work: &Workplace, before: &str, step: &str, options: &str) -> Vec<DVec3> {
    let mut known: Option<Vec<u8>> = None;
    for id in IDS {
        work.write("edit.toml", format!("{before}\n[[step]]\ndeform = \"{id}\"\n{step}\n"));
        for place in PLACES {
            work.simod(&format!(
                "deform model.simod --session edit.toml -o out.ply --isolate {place} {options}"
            ));
            let bytes = std::fs::read(work.path("out.ply")).expect("samples");
            assert!(
                *known.get_or_insert_with(|| bytes.clone()) == bytes,
                "{id} in another process: {place}, {step}"
            );
        }
    }
    work.ply("out.ply").positions()
}

fn now(params: &str) -> String {
    format!("state-version = 2\nparams = {{ {params} }}")
}

#[test]
fn samples_and_surfaces_are_looked_up_in_any_process() {
    let work = workplace();
    let rest = work.ply("model.simod/samples.ply").positions();
    let nearest = |p: DVec3, count: usize, among: &[DVec3]| {
        let mut all: Vec<usize> = (0..among.len()).collect();
        all.sort_by(|i, j| among[*i].distance(p).total_cmp(&among[*j].distance(p)));
        all.truncate(count);
        all
    };
    let mean = |of: &[usize]| of.iter().map(|i| rest[*i]).sum::<DVec3>() / of.len() as f64;
    for (p, q) in rest.iter().zip(deformed(&work, "", &now("mode = \"nearest\""), "")) {
        assert!(q.distance(mean(&nearest(*p, 5, &rest))) < 1e-5, "{p} went to {q}");
    }
    let diagonal = work.ply("model.ply").diagonal();
    let mut most = 0;
    for (p, q) in rest.iter().zip(deformed(&work, "", &now("mode = \"within\", reach = 0.2"), "")) {
        let count = rest.iter().filter(|other| other.distance(*p) <= 0.2 * diagonal).count();
        most = most.max(count);
        assert!(q.distance(mean(&nearest(*p, count, &rest))) < 1e-3 * diagonal, "{p} went to {q}");
    }
    assert!(most > 64, "more than are looked for at first");

    // After a step before it: what is near at rest is not what is near now.
    let bend = "[[step]]\ndeform = \"warp\"\nparams = { operation = \"bend\", angle = 120 }";
    work.write("bend.toml", bend);
    work.simod("deform model.simod --session bend.toml -o bent.ply");
    let bent = work.ply("bent.ply").positions();
    let found = deformed(&work, bend, &now("mode = \"rest\""), "");
    let mut others = 0;
    for (i, q) in found.iter().enumerate() {
        let near = nearest(bent[i], 1, &rest)[0];
        others += usize::from(near != i);
        assert!(q.distance(bent[near]) < 1e-5, "sample {i}");
    }
    assert!(others > 100, "{others} samples are nearer to others' places at rest");

    let reach = 0.3 * diagonal;
    for (p, q) in rest.iter().zip(deformed(&work, "", &now("mode = \"closest\", reach = 0.3"), "")) {
        let from = *p + DVec3::X * reach;
        let corner = rest[nearest(from, 1, &rest)[0]].distance(from);
        assert!(q.distance(from) <= corner + 1e-6, "{p}: {q} is not the nearest");
        let beside = rest[nearest(q, 1, &rest)[0]].distance(q);
        assert!(beside < 0.1 * diagonal, "{p}: {q} is not on the surface");
    }
    let mut lifted = 0;
    for (p, q) in rest.iter().zip(deformed(&work, "", &now("mode = \"ray\""), "")) {
        assert!(
            (q.truncate() - p.truncate()).length() < 1e-5 && q.z > p.z - 0.05 * diagonal,
            "{p} went to {q}"
        );
        lifted += usize::from(q.z > p.z + 0.05 * diagonal);
    }
    assert!((100..400).contains(&lifted), "{lifted} of the samples are below others");

    // Where there are no triangles, that is said.
    work.simod("sample model.ply -o points.simod --samples 500 --skip triangles");
    work.write("edit.toml", format!("[[step]]\ndeform = \"surveyor\"\n{}", now("mode = \"ray\"")));
    // The attributes that the plugin asks for besides are kept, whatever becomes of the step.
    assert_eq!(work.run("deform points.simod --session edit.toml -o out.ply").code, Some(1));
    for place in PLACES {
        let line = format!("deform points.simod --session edit.toml -o out.ply --isolate {place}");
        work.refuses(&line, &["edit.toml, line 1", "surveyor", "no triangles between the samples"]);
    }
}

#[test]
fn the_time_comes_from_the_session_and_the_command() {
    let work = workplace();
    let rest = work.ply("model.simod/samples.ply").positions();
    // One local unit is this many of the model's.
    let step = now("mode = \"time\"");
    let shift = |before: &str, options: &str| {
        let moved = deformed(&work, before, &step, options);
        let by = moved[0] - rest[0];
        assert!(
            moved.iter().zip(&rest).all(|(q, p)| (*q - *p).distance(by) < 1e-4),
            "all of it moves by {by}"
        );
        by
    };
    let unit = shift("", "--frame 1").y;
    assert!(unit > 0.0);
    let expect = |before: &str, options: &str, frame: f64, seconds: f64| {
        let by = shift(before, options) / unit;
        assert!(by.distance(DVec3::new(seconds, frame, 0.0)) < 1e-4, "{before} {options}: {by}");
    };
    expect("", "", 0.0, 0.0);
    expect("[time]\nframe = 6", "", 6.0, 0.25);
    expect("[time]\nframe = 6\nrate = 12", "", 6.0, 0.5);
    expect("[time]\nframe = 6\nrate = 12", "--frame 3", 3.0, 0.25);
    expect("[time]\nframe = 6\nseconds = 2", "--time -0.5", 6.0, -0.5);
    // The whole way takes it as well.
    work.write("whole.toml", format!("[model]\npath = \"model.ply\"\n[sampling]\nsamples = 500\n[[step]]\ndeform = \"surveyor\"\n{step}\n"));
    work.simod("run whole.toml -o moved.ply --frame 2 --time 1");
    let by = work.ply("moved.ply").positions()[7] - work.ply("model.ply").positions()[7];
    assert!((by / unit).distance(DVec3::new(1.0, 2.0, 0.0)) < 1e-3, "{by}");
    work.refuses("deform model.simod --session whole.toml -o out.ply --time nan", &["--time"]);
}

#[test]
fn colours_and_other_attributes_are_those_of_the_model() {
    let work = workplace();
    // A sphere that is the redder the higher it is, and a quality that goes along x.
    let sphere = work.ply("model.ply").positions();
    let write = |name: &str, properties: &str, values: &dyn Fn(&DVec3) -> String| {
        let count = sphere.len();
        let mut text = format!(
            "ply\nformat ascii 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\n\
             {properties}end_header\n"
        );
        sphere.iter().for_each(|p| text += &format!("{} {} {} {}\n", p.x, p.y, p.z, values(p)));
        work.write(name, text);
    };
    let properties = "property uchar red\nproperty list uchar int marks\nproperty double quality\n";
    write("painted.ply", properties, &|p| format!("{} 2 1 2 {}", ((p.z + 1.2) * 100.0) as u8, p.x));
    work.simod("sample painted.ply -o model.simod --samples 500");
    let rest = work.ply("model.simod/samples.ply").positions();
    // One local unit is this many of the model's: the attributes are counted along z, of which there are two.
    let paint = now("mode = \"paint\"");
    let kept = || std::fs::read(work.path("model.simod/attributes.bin")).ok();
    let stages = |line: &str| {
        let report = work.report(line);
        let stages = report["phases"].as_array().expect("stages");
        stages.iter().filter(|s| s["name"] == "reading the attributes").count()
    };
    // A plugin that asks for no attributes causes no reading of them.
    work.write("edit.toml", "[[step]]\ndeform = \"warp\"\nparams = { operation = \"bend\", angle = 30 }");
    assert_eq!(stages("deform model.simod --session edit.toml -o out.ply"), 0);
    assert_eq!(kept(), None);

    let found = deformed(&work, "", &paint, "");
    assert!(kept().is_some());
    let unit = (found[0].z - rest[0].z) / 2.0;
    assert!(unit > 0.0 && found.iter().zip(&rest).all(|(q, p)| ((q.z - p.z) / unit - 2.0).abs() < 1e-4));
    let near = work.ply("model.ply").diagonal() * 0.03;
    for (p, q) in rest.iter().zip(&found) {
        let [red, quality] = [(q.x - p.x) / unit * 255.0, (q.y - p.y) / unit];
        assert!((quality - p.x).abs() < near, "{quality} at {p}");
        assert!((red - ((p.z + 1.2) * 100.0 - 0.5)).abs() < 100.0 * near + 1.0, "{red} at {p}");
    }

    // The model is read once, and not needed any more.
    assert_eq!(stages("deform model.simod --session edit.toml -o out.ply"), 0);
    let whole = kept().expect("a file");
    std::fs::rename(work.path("painted.ply"), work.path("moved.ply")).expect("a file");
    assert_eq!(deformed(&work, "", &paint, ""), found);
    // Where both the kept attributes and the model are missing, that is told; the model may be elsewhere.
    // Damage is mended.
    for damage in 0..8 {
        let mut bytes = whole.clone();
        let place = damage * (bytes.len() - 1) / 7;
        bytes[place] ^= 0x10;
        work.write("model.simod/attributes.bin", &bytes);
        if damage == 0 {
            let line = "deform model.simod --session edit.toml -o out.ply";
            let refused = work.refuses(line, &["painted.ply is gone"]);
            assert!(refused.hint().contains("--model"), "{}", refused.hint());
        }
        let line = "deform model.simod --session edit.toml -o out.ply --model moved.ply";
        assert_eq!(stages(line), 1, "damage at {place}");
        assert_eq!(work.ply("out.ply").positions(), found);
        assert!(kept() == Some(whole.clone()), "it is as it was");
    }
    // Another model of the same size is refused.
    let changed = String::from_utf8(work.read("moved.ply")).expect("text").replace(" 2 1 2 ", " 2 1 3 ");
    work.write("other.ply", changed);
    std::fs::remove_file(work.path("model.simod/attributes.bin")).expect("a file");
    let line = "deform model.simod --session edit.toml -o out.ply --model other.ply";
    work.refuses(line, &["other.ply changed since it was sampled"]);
    assert_eq!(kept(), None);

    // Samples of a refinement have theirs, in the folder as in a session.
    std::fs::rename(work.path("moved.ply"), work.path("painted.ply")).expect("a file");
    let line = "deform model.simod --session edit.toml -o out.ply";
    work.simod(line);
    let refine = "refine model.simod --factor 2 --sphere 0,0,1,0.8 --into fine.simod";
    work.simod(refine);
    work.simod(&line.replace("model.simod", "fine.simod"));
    let (fine, moved) = (work.ply("fine.simod/samples.ply").positions(), work.ply("out.ply").positions());
    assert!(fine.len() > rest.len() + 20 && moved.len() == fine.len());
    for (p, q) in fine.iter().zip(&moved) {
        assert!(((q.y - p.y) / unit - p.x).abs() < near, "{p}");
    }
    let in_session = format!(
        "[[step]]\nrefine = {{ factor = 2, shapes = [{{ sphere = {{ center = [0, 0, 1], radius = 0.8 }} }}] }}\n\
         [[step]]\ndeform = \"surveyor\"\n{paint}"
    );
    work.write("both.toml", in_session);
    work.simod("deform model.simod --session both.toml -o out.ply --refined again.simod");
    assert_eq!(work.ply("out.ply").positions(), moved);

    // The whole way, from the model and back to it.
    work.write_session("painted.ply", 500, &format!("[[step]]\ndeform = \"surveyor\"\n{paint}"));
    assert_eq!(stages("run edit.toml -o run.ply"), 1);
    let (before, after) = (work.ply("painted.ply").positions(), work.ply("run.ply").positions());
    let worst = before.iter().zip(&after).map(|(p, q)| ((q.y - p.y) / unit - p.x).abs()).fold(0.0, f64::max);
    assert!(worst < near, "{worst}");

    // A model without any: nothing is read, and the plugin does without.
    write("plain.ply", "", &|_| String::new());
    work.simod("sample plain.ply -o plain.simod --samples 300");
    let outcome = work.simod("deform plain.simod --session edit.toml -o out.ply --json");
    assert!(warnings(&outcome).iter().any(|w| w.contains("there is no red")), "{}", outcome.stdout);
    assert_eq!(work.ply("out.ply").positions(), work.ply("plain.simod/samples.ply").positions());
    assert_eq!(work.report("plugin info surveyor")["uses_attributes"], true);
}

#[test]
fn other_models_come_in_the_first_one_s_coordinates() {
    let work = workplace();
    let diagonal = work.ply("model.ply").diagonal();
    let to = |file: &str, reach: f64| now(&format!("mode = \"other\", other = \"{file}\", reach = {reach}"));
    let nearest =
        |p: DVec3, among: &[DVec3]| among.iter().map(|q| q.distance(p)).fold(f64::INFINITY, f64::min);

    // A model of more vertices than are taken, elsewhere: samples go to its points, which are on its surface.
    let shifted: String =
        work.ply("model.ply").positions().iter().fold(String::new(), |text, p| {
            text + &format!("{} {} {}\n", p.x * 1.5 + 0.2, p.y * 1.5, p.z * 1.5)
        });
    work.write("cloud.xyz", shifted);
    let surface: Vec<DVec3> =
        work.ply("model.ply").positions().iter().map(|p| *p * 1.5 + DVec3::X * 0.2).collect();
    let found = deformed(&work, "", &to("cloud.xyz", 0.0), "");
    let mut places: Vec<String> = found.iter().map(|p| format!("{p:.4}")).collect();
    places.sort();
    places.dedup();
    assert!((20..=300).contains(&places.len()), "{} points are gone to", places.len());
    assert!(found.iter().all(|p| nearest(*p, &surface) < 0.05 * diagonal), "they are on the surface");
    // Along normals, by the half of the diagonal.
    let lifted = deformed(&work, "", &to("cloud.xyz", 0.5), "");
    let by = found.iter().zip(&lifted).map(|(p, q)| p.distance(*q) / diagonal);
    assert!(by.clone().all(|by| (by - 0.5).abs() < 1e-3), "{:?}", by.fold(0.0, f64::max));

    // Samples that something moved: by their ids, in any order; from the folder of a sampled model, and its
    // file.
    work.write("bend.toml", "[[step]]\ndeform = \"warp\"\nparams = { operation = \"bend\", angle = 70 }");
    work.simod("deform model.simod --session bend.toml -o bent.ply");
    let bent = work.ply("bent.ply").positions();
    let found = deformed(&work, "", &to("bent.ply", 0.0), "");
    assert!(found.iter().zip(&bent).all(|(p, q)| p.distance(*q) < 1e-6 * diagonal));
    let mut lines: Vec<String> =
        bent.iter().enumerate().map(|(i, p)| format!("{} {} {} {i}\n", p.x, p.y, p.z)).collect();
    lines.reverse();
    let header = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
         property float scalar_id\nend_header\n",
        bent.len()
    );
    work.write("reversed.ply", header + &lines.concat());
    let reversed = deformed(&work, "", &to("reversed.ply", 0.0), "");
    assert!(reversed.iter().zip(&bent).all(|(p, q)| p.distance(*q) < 1e-6 * diagonal));
    work.simod("generate -o other.ply --shape bumpy-sphere --vertices 9000");
    work.simod("sample other.ply -o other.simod --samples 800");
    let others = work.ply("other.simod/samples.ply").positions();
    for name in ["other.simod", "other.simod/simod.toml", "other.simod/samples.ply"] {
        let found = deformed(&work, "", &to(name, 0.0), "");
        assert!(found.iter().zip(&others).all(|(p, q)| p.distance(*q) < 1e-5 * diagonal), "{name}");
    }
    // The number of points taken is told; normals are of unit length, triangles within.
    work.write("edit.toml", format!("[[step]]\ndeform = \"surveyor\"\n{}", to("model.ply", 0.0)));
    let line = "deform model.simod --session edit.toml -o out.ply";
    let report = work.report(line);
    let note = report["notes"][0].as_str().expect("a note");
    assert!(note.starts_with("surveyor: model.ply: ") && note.ends_with("of 5000, a surface"), "{note}");

    // An error is told with the parameter's line and the file; nothing is written.
    let wrong = |file: &str, what: &str| {
        let step = to(file, 0.0).replace("params", "\nparams");
        work.write("edit.toml", format!("[[step]]\ndeform = \"surveyor\"\n{step}\n"));
        std::fs::remove_file(work.path("out.ply")).unwrap_or_default();
        work.refuses(line, &["edit.toml, line 5", "surveyor", "`other`", file, what]);
        assert!(!work.path("out.ply").exists());
    };
    wrong("nowhere.ply", "cannot open");
    work.write("empty.ply", "");
    wrong("empty.ply", "");
    work.write("text.xyz", "this is no cloud\n");
    wrong("text.xyz", "");
    let whole = work.read("model.ply");
    work.write("half.ply", &whole[..whole.len() / 2]);
    wrong("half.ply", "");
    work.write("nan.xyz", "nan nan nan\nnan 0 0\n");
    wrong("nan.xyz", "");
    std::fs::create_dir(work.path("folder")).expect("a folder");
    wrong("folder", "no sampled model");
    // An output is never what is read.
    work.write("edit.toml", format!("[[step]]\ndeform = \"surveyor\"\n{}", to("bent.ply", 0.0)));
    work.refuses("deform model.simod --session edit.toml -o bent.ply", &["bent.ply"]);
}

fn warnings(outcome: &Outcome) -> Vec<String> {
    let report: Value = outcome.json();
    let all = report["warnings"].as_array().cloned().unwrap_or_default();
    all.iter().map(|w| w.as_str().expect("text").to_owned()).collect()
}

#[test]
fn older_sessions_keep_working_and_are_told_what_changed() {
    let work = workplace();
    let expected = deformed(&work, "", &now("mode = \"within\", reach = 0.15"), "");
    let old = "params = { method = \"within\", distance = 15 }";
    assert_eq!(deformed(&work, "", old, ""), expected);
    for id in IDS {
        for place in PLACES {
            work.write("edit.toml", format!("# An old one\n[[step]]\ndeform = \"{id}\"\n{old}\n"));
            let deform =
                format!("deform model.simod --session edit.toml -o out.ply --json --isolate {place}");
            let told = warnings(&work.simod(&deform));
            let [method, distance, brought] = &told[..] else { panic!("{told:?}") };
            assert!(
                method.contains("edit.toml, line 2") && method.contains("`method` is called `mode` now"),
                "{method}"
            );
            assert!(distance.contains("`distance` is called `reach` now"), "{distance}");
            let change = "state version 1 to 2: reach = 15 became reach = 0.15";
            assert!(brought.contains(id) && brought.contains(change), "{brought}");

            // Written anew, it says which version it is of, and nothing more is told.
            let migrate = format!("plugin migrate edit.toml -o new.toml --isolate {place}");
            let report = work.report(&migrate);
            assert_eq!(report["changes"].as_array().map(Vec::len), Some(3), "{report}");
            let text = std::fs::read_to_string(work.path("new.toml")).expect("a session");
            assert!(text.contains("state-version = 2") && text.contains("reach = 0.15"), "{text}");
            assert!(text.contains("mode = \"within\"") && !text.contains("method"), "{text}");
            let outcome = work.simod(&deform.replace("edit.toml", "new.toml"));
            assert!(warnings(&outcome).is_empty(), "{}", outcome.stdout);
            assert_eq!(work.ply("out.ply").positions(), expected);

            // An error is told with the plugin, the step, and the parameter's line.
            work.write("bad.toml", format!("[[step]]\ndeform = \"{id}\"\n\nparams.distance = -1\n"));
            let line = format!("deform model.simod --session bad.toml -o out.ply --isolate {place}");
            work.refuses(&line, &["bad.toml, line 4", &format!("plugin {id}"), "`reach` was never below 0"]);
        }
        work.write("new.toml", format!("[[step]]\ndeform = \"{id}\"\nstate-version = 3\n"));
        work.refuses("deform model.simod --session new.toml -o out.ply", &["line 1", id, "state version 3"]);
        let both = "params = { method = \"ray\", mode = \"ray\" }";
        work.write("new.toml", format!("[[step]]\ndeform = \"{id}\"\n{both}\n"));
        work.refuses("deform model.simod --session new.toml -o out.ply", &["line 3", "both are given"]);

        let info = work.report(&format!("plugin info {id}"));
        assert_eq!(info["state_version"], 2, "{info}");
        assert_eq!(info["aliases"][0]["former"], "method", "{info}");
        assert_eq!((&info["uses_time"], &info["uses_rest_positions"]), (&true.into(), &true.into()));
    }
}

#[test]
fn plugins_that_look_things_up_pass_all_rules() {
    let work = workplace();
    for file in [format!("surveyor{DLL_SUFFIX}"), format!("in_c{DLL_SUFFIX}")] {
        let outcome = work.run(&format!("plugin check plugins/{file} --json"));
        let report = outcome.json();
        assert_eq!(report["failed"], 0, "{report}");
        let rules = report["rules"].as_array().expect("rules");
        for id in ["migration", "time", "attributes", "other-models", "no-samples", "not-a-number", "large"] {
            let rule = rules.iter().find(|r| r["rule"] == id).expect("the rule");
            assert_eq!(rule["verdict"], "pass", "{rule}");
        }
    }
}
