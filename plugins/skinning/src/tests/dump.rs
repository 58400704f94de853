use super::scene::{Listener, Scene};
use std::io::Write;
#[test]
fn dump() {
    let Ok(name) = std::env::var("DUMP") else { return };
    let text = std::fs::read_to_string(format!("{name}.obj")).unwrap();
    let mut points: Vec<[f32; 3]> = Vec::new();
    let mut triangles: Vec<[u32; 3]> = Vec::new();
    for line in text.lines() {
        let mut w = line.split_whitespace();
        match w.next() {
            Some("v") => { let v: Vec<f32> = w.map(|x| x.parse().unwrap()).collect(); points.push([v[0], v[1], v[2]]); }
            Some("f") => { let v: Vec<u32> = w.map(|x| x.split('/').next().unwrap().parse::<u32>().unwrap() - 1).collect();
                for k in 1..v.len() - 1 { triangles.push([v[0], v[k], v[k + 1]]); } }
            _ => {}
        }
    }
    let mut scene = Scene::new((points, triangles), &[]);
    scene.skeleton = format!("{name}.tgf");
    scene.resolution = std::env::var("RES").map_or(128.0, |r| r.parse().unwrap());
    scene.influences = 8.0;
    if std::env::var("GEO").is_ok() { scene.binding = "geodesic"; }
    let host = Listener::default();
    let t = std::time::Instant::now();
    let state = scene.try_prepare(&host).unwrap();
    println!("{} points, {} s", scene.points.len(), t.elapsed().as_secs_f64());
    println!("{:?}", host.lines);
    let joints = state.skeleton.joints.len();
    let mut out = vec![0.0_f32; scene.points.len() * joints];
    for i in 0..scene.points.len() { for (j, w) in state.table.of(i) { out[i * joints + j] = w as f32; } }
    let bytes: Vec<u8> = out.iter().flat_map(|x| x.to_le_bytes()).collect();
    std::fs::File::create(format!("{name}.weights")).unwrap().write_all(&bytes).unwrap();
    let ids: Vec<_> = state.skeleton.joints.iter().map(|j| j.id.clone()).collect();
    std::fs::write(format!("{name}.ids"), ids.join("\n")).unwrap();
}
