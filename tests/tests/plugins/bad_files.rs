//! Weights and poses in files that are not what they should be: each is refused with its name, the line and
//! what to do, and nothing is written.

use simod_tests::Workplace;

const STILL: &str = "1 0 0 0 0 1 0 0 0 0 1 0\n";
const ASIDE: &str = "1 0 0 0.1 0 1 0 0 0 0 1 0\n";
/// Of two bones and four places, a number a line.
const WEIGHTS: &str = "2 4\n1\n0.75\n0.25\n0\n0\n0.25\n0.75\n1\n";

/// A bar with a skeleton of two bones, which poses and weights of files move.
fn bar() -> Workplace {
    let work = Workplace::new();
    work.simod("generate --shape bar --vertices 12000 -o bar.ply");
    work.write("bones.tgf", "a 0 0.1 0\nb 0 1 0\nc 0 1.9 0\n#\na b\nb c\n");
    work.write("places.obj", "v 0 0 0\nv 0 0.9 0\nv 0 1.1 0\nv 0 2 0\n");
    work.write("weights.dmat", WEIGHTS);
    work.write("pose.txt", format!("# a frame\n{STILL}{ASIDE}"));
    let params =
        "skeleton = \"bones.tgf\", weights = \"weights.dmat\", places = \"places.obj\", pose = \"pose.txt\"";
    let step = format!("[[step]]\ndeform = \"skinning\"\nstate-version = 3\nparams = {{ {params} }}\n");
    work.write_session("bar.ply", 2000, &step);
    work
}

#[test]
fn poses() {
    let work = bar();
    let refused = |text: &str, parts: &[&str]| {
        work.write("pose.txt", text);
        work.refuses("run edit.toml", &[&["`pose`", "pose.txt"], parts].concat());
    };
    refused("", &["no transforms"]);
    refused(STILL, &["1 transforms", "2 bones"]);
    refused(&format!("{STILL}{STILL}{STILL}"), &["3 transforms", "2 bones"]);
    refused(&format!("{STILL}1 0 0 0 0 1 0 0 0 0 1\n"), &["line 2", "11 numbers"]);
    refused(&format!("{STILL}{STILL} 1"), &["line 3", "1 numbers"]);
    refused(&format!("{STILL}\n1 0 0 nan 0 1 0 0 0 0 1 0\n"), &["line 3", "`nan`"]);
    refused(&format!("{STILL}1e300 0 0 0 0 1 0 0 0 0 1 0\n"), &["line 2", "too large"]);
    refused(&format!("{STILL}# mirrored\n-1 0 0 0 0 1 0 0 0 0 1 0\n"), &["line 3", "mirrors or flattens"]);
    refused(&format!("{}{STILL}", "0 ".repeat(12).trim_end().to_owned() + "\n"), &["line 1", "flattens"]);
    work.write("pose.txt", format!("{STILL}{ASIDE}"));
    work.simod("run edit.toml");
}

#[test]
fn weights() {
    let work = bar();
    let refused = |text: &str, parts: &[&str]| {
        work.write("weights.dmat", text);
        work.refuses("run edit.toml", &[&["`weights`", "weights.dmat"], parts].concat());
    };
    refused("", &["line 1", "numbers of columns and rows"]);
    refused(&WEIGHTS.replace("2 4", "2 3"), &["8 numbers instead of 6"]);
    refused(WEIGHTS.trim_end_matches("1\n"), &["7 numbers instead of 8"]);
    refused(&WEIGHTS.replace("2 4", "4 2"), &["line 1", "4 columns", "2 bones"]);
    refused("2 3\n1 0.5 0 0 0.5 1\n", &["line 1", "3 rows", "4 places"]);
    refused(&WEIGHTS.replacen("0.25", "nan", 1), &["line 4", "row 3, column 1"]);
    refused(&WEIGHTS.replacen("0.25", "x", 1), &["line 4", "`x`"]);
    refused(&WEIGHTS.replacen("0.25", "-0.25", 1), &["line 4", "negative weight in row 3"]);
    refused("2 4\n1 1 1 0\n0 0 0 0\n", &["line 2", "no weight above 0 in row 4"]);
    work.write("weights.dmat", WEIGHTS);
    work.write("places.obj", "v 0 0 0\nv 0 0.9 0\nv 0 1.1\nv 0 2 0\n");
    work.refuses("run edit.toml", &["`places`", "places.obj", "line 3"]);
    work.write("places.obj", "v 90 0 0\nv 90 0.9 0\nv 90 1.1 0\nv 90 2 0\n");
    work.refuses("run edit.toml", &["`weights`", "no place near the model"]);
}
