use glam::DVec3;
use simod_core::*;
use simod_core::progress::Silent;
use simod_core::reconstruction::*;
use simod_core::sampling::*;
use std::time::Instant;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let m = model::open(a[1].as_ref()).unwrap();
    let n: u64 = a[2].parse().unwrap();
    let t = Instant::now();
    let s = sample(m.as_ref(), &Sampling { target: Target::Samples(n), grid: a.get(3).map(|x| x.parse().unwrap()) }, &Silent).unwrap();
    println!("sample {:.3}s: {} of {} cells {}", t.elapsed().as_secs_f64(), s.samples.len(), m.info().vertices, s.cells);
    let b = s.bounds;
    let (lo, hi) = (b.min.y, b.max.y);
    let c = b.center();
    let twist = move |p: DVec3| { let ang = (p.y - lo) / (hi - lo) * std::f64::consts::PI; let (s, co) = ang.sin_cos(); let d = p - c; DVec3::new(c.x + co*d.x + s*d.z, p.y, c.z - s*d.x + co*d.z) };
    let k = std::f64::consts::FRAC_PI_2 / (hi - lo);
    let bend = move |p: DVec3| { let th = k*(p.y-c.y); let (s, co) = th.sin_cos(); let x = p.x - c.x; DVec3::new(c.x + 1.0/k - (1.0/k - x)*co, c.y + (1.0/k - x)*s, p.z) };
    let rot = glam::DQuat::from_euler(glam::EulerRot::XYZ, 1.0, 2.0, 0.5);
    let rigid = move |p: DVec3| rot * (p - c) + c + DVec3::splat(0.3 * b.diagonal());
    let sim = move |p: DVec3| rot * (p - c) * 1.9 + c;
    let maps: [(&str, Box<dyn Fn(DVec3) -> DVec3>); 5] = [("identity", Box::new(|p| p)), ("rigid", Box::new(rigid)), ("similarity", Box::new(sim)), ("twist", Box::new(twist)), ("bend", Box::new(bend))];
    for (name, f) in maps {
        let d: Vec<glam::Vec3> = s.samples.positions.iter().map(|p| s.frame.to_local(f(s.frame.to_model(*p)))).collect();
        let d = s.rounded(&d);
        let out = std::path::Path::new("/tmp/dev-out.ply");
        let t = Instant::now();
        reconstruct(&s, m.as_ref(), &d, out, &Silent).unwrap();
        let dt = t.elapsed().as_secs_f64();
        let o = model::open(out).unwrap();
        let e = transfer_error::measure(m.as_ref(), o.as_ref(), b.diagonal(), &|pts| { for p in pts.iter_mut() { *p = f(*p); } Ok(()) }, &Silent).unwrap();
        println!("{name:>10}: {dt:.3}s rms {:.2e} p999 {:.2e} max {:.2e} jump {:.2e}", e.rms, e.p999, e.max, e.jump);
    }
}
