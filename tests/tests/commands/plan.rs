//! A session by units, in any order, more than once, killed and damaged: the same bytes as by one command.

use std::collections::BTreeMap;
use std::process::{Command, Stdio};
use std::time::Duration;

use simod_tests::{Workplace, skip};

/// More than three pieces.
const VERTICES: u64 = 230_000;

/// The jar is bent, and its mouth is pulled aside.
const STEPS: &str = r#"
[[step]]
deform = "warp"
params = { operation = "twist", angle = 100, center = [0, 0.75, 0], from = -0.3, to = 0.3 }
[[step]]
deform = "rbf"
amount = 0.75
[[step.region]]
role = "fixed"
shapes = [{ half-space = { point = [0, 0.8, 0], normal = [0, -1, 0] } }]
[[step.region]]
role = "handle"
shapes = [{ half-space = { point = [0, 1.85, 0], normal = [0, 1, 0] } }]
move = { translate = [0.35, -0.05, 0], axis = [0, 0, 1], degrees = -35, pivot = [0, 1.95, 0] }
"#;

/// A twist alone, and before it a refinement.
const REFINED: &str = r#"
[[step]]
refine = { shapes = [{ half-space = { point = [0, 1.2, 0], normal = [0, 1, 0] } }], factor = 3 }
[[step]]
deform = "warp"
params = { operation = "twist", angle = 100, center = [0, 0.75, 0], from = -0.3, to = 0.3 }
"#;

/// A jar with its session, and what `simod run` makes of it: `edited.ply`.
fn jar(name: &str, options: &str, steps: &str) -> Workplace {
    let work = Workplace::new();
    if name == "quad.ply" {
        quads(&work, name);
        work.write_session(name, VERTICES / 50, steps);
        return work;
    }
    work.simod(&format!("generate -o made.ply --vertices {VERTICES} {options}"));
    if name == "made.ply" {
        work.write_session(name, VERTICES / 50, steps);
    } else {
        work.simod(&format!("convert made.ply {name} --lossy"));
        work.write_session(name, VERTICES / 50, steps);
    }
    work
}

/// A wavy sheet as large as the jar, of quads and, in every fifth place, two triangles.
fn quads(work: &Workplace, name: &str) {
    const SIDE: u32 = 480;
    let (mut vertices, mut faces, mut count) = (Vec::new(), Vec::new(), 0);
    for vertex in 0..SIDE * SIDE {
        let [u, v] = [vertex % SIDE, vertex / SIDE].map(|i| i as f32 / SIDE as f32);
        let place = [u - 0.5, 2.0 * v, 0.1 * (9.0 * u).sin() * (7.0 * v).cos()];
        vertices.extend(place.iter().flat_map(|x| x.to_le_bytes()));
        if vertex % SIDE == SIDE - 1 || vertex / SIDE == SIDE - 1 {
            continue;
        }
        let [a, b, c, d] = [vertex, vertex + 1, vertex + SIDE + 1, vertex + SIDE];
        let of_place =
            if vertex % 5 == 0 { vec![vec![a, b, c], vec![a, c, d]] } else { vec![vec![a, b, c, d]] };
        for face in of_place {
            faces.push(face.len() as u8);
            faces.extend(face.iter().flat_map(|corner| corner.to_le_bytes()));
            count += 1;
        }
    }
    let vertex = "property float x\nproperty float y\nproperty float z";
    let header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n{vertex}\nelement face {count}\n\
         property list uchar uint vertex_indices\nend_header\n",
        SIDE * SIDE
    );
    work.write(name, [header.into_bytes(), vertices, faces].concat());
}

/// Content of the plan's file.
fn plan(work: &Workplace) -> toml::Table {
    String::from_utf8(work.read("plan/plan.toml")).expect("UTF-8").parse().expect("TOML")
}

/// The units of each stage, by the stages' order.
pub(crate) fn stages(work: &Workplace) -> Vec<Vec<usize>> {
    let mut stages: Vec<(String, Vec<usize>)> = Vec::new();
    for unit in plan(work)["unit"].as_array().expect("units") {
        let stage = unit["stage"].as_str().expect("a stage");
        let number = unit["number"].as_integer().expect("a number") as usize;
        match stages.last_mut() {
            Some((last, units)) if last == stage => units.push(number),
            _ => stages.push((stage.to_owned(), vec![number])),
        }
    }
    stages.into_iter().map(|(_, units)| units).collect()
}

/// Does all units, each stage from its end, and each unit twice.
pub(crate) fn do_all(work: &Workplace) {
    for stage in stages(work) {
        for unit in stage.iter().rev() {
            let first = work.report(&format!("unit plan {unit}"));
            assert_eq!(first["was_done"], false, "{first}");
            let again = work.report(&format!("unit plan {unit}"));
            assert_eq!(again["was_done"], true, "{again}");
        }
    }
}

/// Names in the plan's folder, hidden ones as well.
pub(crate) fn left(work: &Workplace) -> Vec<String> {
    let entries = std::fs::read_dir(work.path("plan")).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8")).collect();
    names.sort();
    names
}

#[test]
fn units_write_what_one_command_writes() {
    for (name, options, steps, units) in [
        ("made.ply", "", STEPS, 3),
        ("made.ply", "", STEPS, 1),
        ("made.ply", "", REFINED, 2),
        ("made.ply", "--no-normals", STEPS, 6),
        ("made.ply", "--no-normals --no-faces", REFINED, 2),
        ("made.ply", "--no-faces", STEPS, 3),
        ("made.laz", "", REFINED, 4),
        ("made.stl", "", STEPS, 2),
        ("quad.ply", "", STEPS, 3),
        ("quad.ply", "", REFINED, 4),
        ("made.xyz", "", STEPS, 2),
    ] {
        let work = jar(name, options, steps);
        let to = format!("edited.{}", &name[5..]);
        let (expected, run) = (format!("run-{to}"), format!("run edit.toml -o run-{to}"));
        let run = work.report(&run);
        let planned = work.report(&format!("plan edit.toml -o plan --units {units} --to {to}"));
        assert_eq!(planned["vertices"], run["vertices"]);
        // Text is counted and written by one unit.
        let is_divided = name != "made.xyz";
        assert_eq!(planned["writing_units"], if is_divided { units } else { 1 }, "{name}: {planned}");
        // Ranges are clustered, and groups of the cells that they share.
        let is_clustered = units > 1 && is_divided;
        let clustering = if is_clustered { 2 * units } else { 0 };
        assert_eq!(planned["clustering_units"], clustering, "{name}: {planned}");
        let has_faces = name != "made.laz" && !options.contains("--no-faces");
        assert_eq!(planned["face_units"], if has_faces { clustering } else { 0 }, "{name}: {planned}");
        let exchange = planned["exchange_at_most_bytes"].as_u64().expect("a number");
        assert!(if is_clustered { exchange > 12 * VERTICES } else { exchange == 0 }, "{name}: {planned}");
        do_all(&work);
        assert!(work.read(&to) == work.read(&expected), "{name} by {units} units differs");
        let removed = [".", "part-", "cluster-", "shared-", "group-", "leaves-", "members-", "faces-"];
        let stays = |name: &String| removed.iter().any(|prefix| name.starts_with(prefix));
        assert!(!left(&work).iter().any(stays), "{:?}", left(&work));
        // When all is done, no unit does anything.
        let last = stages(&work).concat().len();
        for unit in 0..last {
            assert_eq!(work.report(&format!("unit plan {unit}"))["was_done"], true);
        }
        assert!(work.read(&to) == work.read(&expected));
    }
}

#[test]
fn options_are_those_of_a_run() {
    let work = jar("made.ply", "", STEPS);
    for options in ["--normals drop --method projected-barycentric", "--follow none --frame 3"] {
        work.simod(&format!("run edit.toml -o run.ply {options}"));
        work.simod(&format!("plan edit.toml -o plan --units 2 --to units.ply {options}"));
        do_all(&work);
        assert!(work.read("units.ply") == work.read("run.ply"), "{options}");
    }
    work.simod("run edit.toml -o run.pcd --lossy");
    let planned = work.simod("plan edit.toml -o plan --units 2 --to units.pcd --lossy");
    assert!(planned.stderr.contains("another format"), "{}", planned.stderr);
    do_all(&work);
    assert!(work.read("units.pcd") == work.read("run.pcd"));
}

#[test]
fn engines_do_the_units() {
    ["", "--no-faces"].into_iter().for_each(by_engines);
}

fn by_engines(options: &str) {
    let work = jar("made.ply", options, STEPS);
    work.simod("run edit.toml -o run.ply");
    let emit = "--emit make,slurm,commands --emit make";
    work.simod(&format!("plan edit.toml -o plan --units 3 {emit}"));
    assert_eq!(left(&work), ["Makefile", "commands.txt", "plan.toml", "slurm.sh"]);

    // A farm that does the lines of each stage from the last to the first.
    let commands = String::from_utf8(work.read("plan/commands.txt")).expect("UTF-8");
    let mut waiting = Vec::new();
    for line in commands.lines().chain(["# the end"]) {
        if line.starts_with('#') {
            waiting.drain(..).rev().for_each(|line| shell(&work, line));
        } else {
            waiting.push(line);
        }
    }
    assert!(work.read("edited.ply") == work.read("run.ply"), "the farm's differs");

    if Command::new("make").arg("--version").output().is_err() {
        return skip("make is not there");
    }
    std::fs::remove_file(work.path("edited.ply")).expect("the output");
    work.simod(&format!("plan edit.toml -o plan --units 3 {emit}"));
    shell(&work, "make -s -C plan -j 4");
    assert!(work.read("edited.ply") == work.read("run.ply"), "the one of make differs");
    // Again, nothing is to be done, though the parts are gone.
    shell(&work, "make -q -C plan");
}

#[test]
fn a_scheduler_of_arrays_gets_stages_with_their_dependencies() {
    let mesh = [
        "101 after none: 0 to 2",
        "102 after 101: one to one",
        "103 after 102: 4 to 6",
        "104 after 103: 7 to 9",
        "105 after 103:104: one to one",
        "106 after 105: 11 to 13",
        "107 after 106: 14 to 16",
        "108 after 107: one to one",
        "109 after 108: one to one",
        "110 after 109: 19 to 21",
        "111 after 110: one to one",
    ];
    let cloud = [
        "101 after none: 0 to 2",
        "102 after 101: one to one",
        "103 after 102: 4 to 6",
        "104 after 103: 7 to 9",
        "105 after 103:104: one to one",
        "106 after 105: one to one",
        "107 after 106: 12 to 14",
        "108 after 107: one to one",
    ];
    by_arrays("", &mesh);
    by_arrays("--no-faces", &cloud);
}

fn by_arrays(options: &str, expected: &[&str]) {
    let work = jar("made.ply", options, STEPS);
    work.simod("run edit.toml -o run.ply");
    work.simod("plan edit.toml -o plan --units 3 --emit slurm");
    // This stand-in runs its script at once, an array from its end, and notes what the script depends on.
    work.write(
        "bin/sbatch",
        r#"#!/bin/sh
log=$LOG; first=; last=; after=none
while [ $# -gt 0 ]; do
    case $1 in
        --array=*) range=${1#--array=}; first=${range%-*}; last=${range#*-} ;;
        --dependency=*) after=${1#--dependency=afterok:} ;;
        --wrap) wrap=$2; shift ;;
    esac
    shift
done
number=$(($(wc -l < "$log" 2>/dev/null || echo 0) + 101))
echo "$number after $after: ${first:-one} to ${last:-one}" >> "$log"
if [ -z "$first" ]; then sh -c "$wrap" >&2 || exit 1; fi
while [ -n "$first" ] && [ "$last" -ge "$first" ]; do
    SLURM_ARRAY_TASK_ID=$last sh -c "$wrap" >&2 || exit 1
    last=$((last - 1))
done
echo "$number;cluster"
"#,
    );
    shell(&work, "chmod +x bin/sbatch; touch log; PATH=$PWD/bin:$PATH LOG=$PWD/log sh plan/slurm.sh");
    assert!(work.read("edited.ply") == work.read("run.ply"));
    let log = String::from_utf8(work.read("log")).expect("UTF-8");
    assert_eq!(log.lines().collect::<Vec<_>>(), expected);
}

/// Runs a line of the shell, which has to succeed.
pub(crate) fn shell(work: &Workplace, line: &str) {
    let done =
        work.prepared(Command::new("/bin/sh")).args(["-c", line]).env("PATH", "/usr/bin:/bin").output();
    let done = done.expect("a shell");
    assert!(done.status.success(), "{line}: {}", String::from_utf8_lossy(&done.stderr));
}

/// Units that are killed at any time leave nothing that hurts: done again, they do what they would have done.
#[test]
fn killed_units_are_done_again() {
    ["made.laz", "made.ply", "quad.ply", "made.stl"].into_iter().for_each(killed);
}

fn killed(name: &str) {
    let (work, format) = (jar(name, "", STEPS), &name[5..]);
    let [run, edited] = ["run", "edited"].map(|name| format!("{name}.{format}"));
    work.simod(&format!("run edit.toml -o {run}"));
    work.simod(&format!("plan edit.toml -o plan --units 3 --to {edited}"));
    let last = stages(&work).concat().len() - 1;
    let mut state = 12345u64;
    let (mut killed, mut spared) = (BTreeMap::new(), 0);
    for stage in stages(&work) {
        for unit in stage {
            for attempt in 1..30u64 {
                let mut child = work.command(&format!("unit plan {unit}"));
                let child = child.stdout(Stdio::null()).stderr(Stdio::null());
                let mut child = child.spawn().expect("the program starts");
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                // Later each time, so that it comes to an end.
                std::thread::sleep(Duration::from_micros((state >> 33) % (4000 * attempt * attempt)));
                let _ = child.kill();
                if child.wait().expect("an end").success() {
                    spared += 1;
                    break;
                }
                *killed.entry(unit).or_insert(0) += 1;
                assert!(!work.path(&edited).exists() || unit == last, "unit {unit} wrote the output");
            }
            work.simod(&format!("unit plan {unit}"));
        }
    }
    assert!(work.read(&edited) == work.read(&run), "{killed:?} {spared}");
    assert!(killed.values().sum::<i32>() > 10, "{killed:?}");
    let hidden: Vec<String> = left(&work).into_iter().chain(work.names()).collect();
    assert!(!hidden.iter().any(|name| name.starts_with(".simod")), "{hidden:?}");
}

/// A process that is killed as it lets a folder go, leaves what it held it by; one that is killed as it
/// tidies, leaves parts. The last unit removes both, whenever it was done.
#[test]
fn what_killed_units_have_left_goes_with_the_last_one() {
    let work = jar("made.ply", "", STEPS);
    work.simod("plan edit.toml -o plan --units 2 --to edited.ply");
    let all = stages(&work).concat();
    let (last, before) = all.split_last().expect("units");
    before.iter().for_each(|unit| drop(work.simod(&format!("unit plan {unit}"))));
    let part = work.read("plan/part-1.bin");
    work.write("plan/.simod-sampled.simod.part", "");
    work.simod(&format!("unit plan {last}"));
    let tidied = left(&work);
    assert!(!tidied.iter().any(|name| name.starts_with(".simod") || name.starts_with("part-")), "{tidied:?}");
    work.write("plan/.simod-sampled.simod.part", "");
    work.write("plan/part-1.bin", part);
    assert_eq!(work.report(&format!("unit plan {last}"))["was_done"], true);
    assert_eq!(left(&work), tidied);
}

/// `finish` is killed when the output is in its place, before it has said so; then a part is done once more,
/// to a file of its own that has nothing else. Whatever comes next, the output stays.
#[test]
fn a_part_that_is_done_again_behind_a_killed_finish_takes_nothing_along() {
    let work = jar("made.ply", "--no-faces", STEPS);
    work.simod("run edit.toml -o run.ply");
    work.simod("plan edit.toml -o plan --units 3 --to edited.ply");
    let all = stages(&work);
    let (finish, before) = all.split_last().expect("stages");
    before.concat().iter().for_each(|unit| drop(work.simod(&format!("unit plan {unit}"))));
    let parts: Vec<String> = left(&work).into_iter().filter(|name| name.starts_with("part-")).collect();
    let kept: Vec<Vec<u8>> = parts.iter().map(|name| work.read(&format!("plan/{name}"))).collect();
    work.simod(&format!("unit plan {}", finish[0]));
    for (apply, lost) in before.last().expect("units of apply").iter().zip(&parts) {
        // As the plan was when `finish` was killed, but for one part.
        std::fs::remove_file(work.path("plan/finished.toml")).expect("it is there");
        for (name, bytes) in parts.iter().zip(&kept).filter(|(name, _)| *name != lost) {
            work.write(&format!("plan/{name}"), bytes);
        }
        work.simod(&format!("unit plan {apply}"));
        work.simod(&format!("unit plan {}", finish[0]));
        assert!(work.read("edited.ply") == work.read("run.ply"), "{lost}");
        assert!(!left(&work).iter().any(|name| name == "output.bin"), "{:?}", left(&work));
    }
    // Where the output is gone as well, that is told, and nothing takes its place.
    std::fs::remove_file(work.path("plan/finished.toml")).expect("it is there");
    std::fs::remove_file(work.path("edited.ply")).expect("it is there");
    parts[..2].iter().zip(&kept).for_each(|(name, bytes)| work.write(&format!("plan/{name}"), bytes));
    work.simod(&format!("unit plan {}", before.last().expect("units of apply")[2]));
    work.refuses(&format!("unit plan {}", finish[0]), &["the bytes of the parts of", "are gone"]);
    assert!(!work.path("edited.ply").exists());
}

#[test]
fn what_is_wrong_is_told() {
    let work = jar("made.ply", "", STEPS);
    work.refuses("unit plan 0", &["plan", "no plan"]);
    work.write("folder/mine", "precious");
    work.refuses("plan edit.toml -o folder", &["folder", "is no plan"]);
    work.refuses("plan edit.toml -o plan --to made.ply", &["made.ply"]);
    work.refuses("plan edit.toml -o plan --model missing.ply", &["missing.ply"]);
    work.simod("plan edit.toml -o plan --units 2");
    work.refuses("plan edit.toml -o plan --to plan/out.ply", &["out.ply", "plan's folder"]);
    work.write("plan/notes.txt", "precious");
    work.refuses("plan edit.toml -o plan", &["notes.txt", "beside the plan"]);
    std::fs::remove_file(work.path("plan/notes.txt")).expect("notes");
    work.refuses("unit plan 17", &["no unit 17"]);
    for unit in 2..17 {
        work.refuses(&format!("unit plan {unit}"), &["has to be done before"]);
    }
    for unit in 0..14 {
        work.simod(&format!("unit plan {unit}"));
    }
    // A part that is not what was written is noticed, and is written again.
    work.simod("unit plan 14");
    work.simod("unit plan 15");
    let mut part = work.read("plan/part-1.bin");
    let good = part.clone();
    part[100] ^= 1;
    work.write("plan/part-1.bin", &part);
    work.refuses("unit plan 16", &["part-1.bin", "checksum"]);
    std::fs::remove_file(work.path("plan/part-1.bin")).expect("a part");
    work.refuses("unit plan 16", &["unit 15 (apply) has to be done before"]);
    work.simod("unit plan 15");
    assert!(work.read("plan/part-1.bin") == good);
    // The session, the model, and the plan itself.
    let session = work.read("edit.toml");
    work.write("edit.toml", [&session[..], b"\n# changed\n"].concat());
    std::fs::remove_dir_all(work.path("plan/sampled.simod")).expect("samples");
    work.refuses("unit plan 12", &["edit.toml", "changed since the plan was made"]);
    work.write("edit.toml", &session);
    work.simod("unit plan 12");
    let model = work.read("made.ply");
    work.write("made.ply", &model[..model.len() - 1]);
    work.refuses("unit plan 16", &["made.ply"]);
    // The same length, and another place of one vertex.
    let mut other = model.clone();
    let at = model.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
    other[at + 1000 * 15 + 1] ^= 1;
    work.write("made.ply", &other);
    work.refuses("unit plan 16", &["part-0.bin", "another model"]);
    work.simod("unit plan 14");
    work.simod("unit plan 15");
    work.refuses("unit plan 16", &["made.ply", "changed since it was sampled"]);
    let text = String::from_utf8(work.read("plan/plan.toml")).expect("UTF-8");
    for (from, to) in [
        ("simod-plan/1", "simod-plan/9"),
        ("stage = \"complete\"", "stage = \"dance\""),
        ("number = 3", "number = 4"),
        ("part-1.bin", "../part-1.bin"),
        ("after = [13]", "after = [19]"),
        ("blended-jets", "magic"),
        ("program = \"", "program = \"9"),
    ] {
        assert!(text.contains(from), "{from}: {text}");
        work.write("plan/plan.toml", text.replacen(from, to, 1));
        work.refuses("unit plan 0", &["plan.toml"]);
    }
}

/// Vectors that follow turn by gradients that the steps know, and these reach the units.
#[test]
fn splats_turn_in_units_as_in_a_run() {
    let work = Workplace::new();
    let mut records = Vec::new();
    for i in 0..150_000u32 {
        let (u, v) = (i as f32 * 0.618_034 % 1.0, i as f32 / 150_000.0);
        let angle = u * std::f32::consts::TAU;
        [angle.cos(), 2.0 * v, angle.sin(), 0.01, 0.02, 0.005]
            .iter()
            .for_each(|x| records.extend(x.to_le_bytes()));
        records.extend([200, 100, 50, 255, 255, (i % 200) as u8, 128, 90]);
    }
    work.write("made.splat", records);
    let twist = r#"
[[step]]
deform = "warp"
params = { operation = "twist", angle = 100, center = [0, 1, 0], from = -0.8, to = 0.8 }
"#;
    work.write_session("made.splat", 2000, twist);
    work.simod("run edit.toml -o run.splat");
    work.simod("plan edit.toml -o plan --units 2 --to units.splat");
    do_all(&work);
    assert!(left(&work).contains(&"gradients.bin".to_owned()));
    assert!(work.read("units.splat") == work.read("run.splat"));
}
