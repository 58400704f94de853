//! Deformed samples as targets, from a session to the model's vertices.

use glam::DVec3;
use simod_tests::Workplace;

#[test]
fn targets_are_added_by_their_amounts() {
    let work = Workplace::new();
    work.simod("generate --shape bar -o bar.ply --vertices 20000");
    work.simod("sample bar.ply -o bar.simod --samples 3000");
    let target = |name: &str, by: &str| {
        let step = format!("[[step]]\ndeform = \"warp\"\nparams = {{ operation = \"stretch\", {by} }}\n");
        work.write("target.toml", step);
        work.simod(&format!("deform bar.simod --session target.toml -o {name} --force"));
    };
    target("long.ply", "axis = [0, 1, 0], factor = 1.5");
    let before = work.ply("bar.ply").positions();
    let extent = |places: &[DVec3]| {
        let all = places.iter().map(|p| p.y);
        all.clone().fold(f64::MIN, f64::max) - all.fold(f64::MAX, f64::min)
    };
    let run = |amount: f64| {
        let step = format!(
            "[[step]]\ndeform = \"blendshapes\"\nparams = {{ target-1 = \"long.ply\", amount-1 = {amount} }}\n"
        );
        work.write_session("bar.ply", 3000, &step);
        work.simod("run edit.toml -o out.ply --force");
        work.ply("out.ply").positions()
    };
    assert!(run(0.0) == before, "what counts nothing changes nothing");
    let [half, whole, more] = [0.5, 1.0, 2.0].map(|amount| extent(&run(amount)) - extent(&before));
    assert!(whole > 0.1 && (half / whole - 0.5).abs() < 0.01 && (more / whole - 2.0).abs() < 0.01);
    // Of other samples.
    work.simod("sample bar.ply -o fine.simod --samples 5000");
    let step = "[[step]]\ndeform = \"warp\"\nparams = { operation = \"twist\", angle = 20 }\n";
    work.write("target.toml", step);
    work.simod("deform fine.simod --session target.toml -o long.ply --force");
    work.refuses("run edit.toml --force", &["`target-1` is of another sampling"]);
    work.write("long.ply", work.read("bar.ply"));
    work.refuses("run edit.toml --force", &["no ids"]);
}
