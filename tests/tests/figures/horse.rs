//! A real scan, and the session and commands of the manual on it.

use glam::DVec3;
use simod_tests::{Ply, Workplace, real_model, workspace};

#[test]
fn the_horse_turns_its_head() {
    let Some(horse) = real_model("horse.ply") else { return };
    let work = Workplace::new();
    std::fs::copy(horse, work.path("horse.ply")).expect("a copy");
    let before = work.ply("horse.ply");
    let ([min, max], diagonal) = (before.bounds(), before.diagonal());
    // Twisted about its longest side, the other half masked out.
    let size = max - min;
    let axis = DVec3::AXES[size.max_position()];
    let (middle, end) = ((min + max) / 2.0, (min + max) / 2.0 + size / 2.0 * axis);
    let half = format!("{{ half-space = {{ point = {}, normal = {} }} }}", vector(middle), vector(axis));
    let steps = format!(
        "[[step]]\ndeform = \"warp\"\nparams = {{ operation = \"twist\", angle = 40, axis = {}, center = {}, \
         from = 0, to = 0.3 }}\n[[step.region]]\nrole = \"mask\"\nshapes = [{half}]\n",
        vector(axis),
        vector(middle),
    );
    work.write_session("horse.ply", 10_000, &steps);

    let info = work.report("info horse.ply");
    assert_eq!((&info["vertices"], &info["faces"]), (&48_485.into(), &96_966.into()));
    let report = work.report("sample horse.ply -o horse.simod --samples 10000");
    let samples = report["samples"].as_u64().expect("a number");
    assert!((9800..=10_000).contains(&samples), "{samples} samples");
    work.simod("deform horse.simod --session edit.toml -o deformed.ply");
    work.simod("reconstruct horse.simod --deformed deformed.ply -o horse-edited.ply");
    let report = work.report("run edit.toml --measure");
    assert!(work.read("edited.ply") == work.read("horse-edited.ply"));

    let after = work.ply("edited.ply");
    assert!(after.other_bytes() == before.other_bytes());
    let (mut still, mut turned) = (0, 0);
    for (p, q) in before.positions().into_iter().zip(after.positions()) {
        let along = (p - middle).dot(axis);
        if along < -0.05 * diagonal {
            assert_eq!(p, q);
            still += 1;
        } else if along > 0.05 * diagonal {
            // A turn: along the axis nothing changes, nor the distance from it.
            let radius = |v: DVec3| (v - end).reject_from(axis).length();
            assert!((q - p).dot(axis).abs() < 0.01 * diagonal, "{p} went to {q}");
            assert!((radius(p) - radius(q)).abs() < 0.01 * diagonal, "{p} went to {q}");
            turned += 1;
        }
    }
    assert!(still > 10_000 && turned > 10_000, "{still} stand still, {turned} turned");
    let error = &report["transfer_error"];
    assert!(error["rms"].as_f64().is_some_and(|e| e < 1e-3), "{error}");
    assert!(error["max"].as_f64().is_some_and(|e| e < 2e-2), "{error}");
}

/// The README's session and its commands, as they stand there.
#[test]
fn the_manual_is_right() {
    let Some(horse) = real_model("horse.ply") else { return };
    let work = Workplace::new();
    std::fs::copy(horse, work.path("horse.ply")).expect("a copy");
    let manual = std::fs::read_to_string(workspace().join("README.md")).expect("a README");
    let lines: Vec<&str> = manual.lines().filter_map(|line| line.strip_prefix("    ")).collect();
    let session = lines.iter().skip_while(|line| **line != "[model]").copied().collect::<Vec<_>>();
    let end = session.iter().position(|line| *line == "[output]").expect("an output") + 2;
    work.write("edit.toml", session[..end].join("\n"));
    let commands: Vec<&str> = lines.iter().filter_map(|line| line.strip_prefix("simod ")).collect();
    assert_eq!(commands.len(), 3, "{commands:?}");
    commands.into_iter().for_each(|command| drop(work.simod(command)));
    let by_steps = work.read("horse-edited.ply");
    work.simod("run edit.toml");
    assert!(work.read("horse-edited.ply") == by_steps);
    let moved = work.ply("horse.ply").positions().into_iter().zip(work.ply("horse-edited.ply").positions());
    assert!(moved.filter(|(p, q)| p.distance(*q) > 1e-3).count() > 10_000);
}

/// As TOML has it.
fn vector(v: DVec3) -> String {
    format!("[{}, {}, {}]", v.x, v.y, v.z)
}

/// Each leg is drawn away from the others, and none drags another.
#[test]
fn the_horse_spreads_its_legs() {
    let Some(horse) = real_model("horse.ply") else { return };
    let work = Workplace::new();
    std::fs::copy(horse, work.path("horse.ply")).expect("a copy");
    let before = work.ply("horse.ply");
    let (legs, diagonal) = (Legs::from_horse(&before), before.diagonal());
    // The largest deviation of any vertex, as a fraction of the diagonal: of both methods, for so many
    // samples.
    for (samples, jets, barycentric) in [(10_000, 1e-4, 6e-3), (2000, 4e-4, 4e-2)] {
        work.simod(&format!("sample horse.ply -o horse.simod --samples {samples}"));
        work.move_samples("horse.simod", |p| legs.spread(p));
        for (method, tolerance) in [("blended-jets", jets), ("projected-barycentric", barycentric)] {
            work.simod(&format!(
                "reconstruct horse.simod --deformed deformed.ply -o out.ply --method {method}"
            ));
            let after = work.ply("out.ply").positions();
            let deviations =
                before.positions().into_iter().zip(after).map(|(p, q)| legs.spread(p).distance(q));
            let worst = deviations.max_by(f64::total_cmp).expect("vertices") / diagonal;
            assert!(worst < tolerance, "{method}, {samples} samples: off by {worst:.1e}");
        }
    }
}

/// The horse's legs: what is below its hips, on four sides of the place between them.
struct Legs {
    hips: f64,
    length: f64,
    between: DVec3,
}

impl Legs {
    fn from_horse(horse: &Ply) -> Self {
        let [min, max] = horse.bounds();
        let size = max - min;
        let hips = min.z + 0.35 * size.z;
        let between = min + DVec3::new(0.64, 0.33, 0.0) * size;
        Self { hips, length: hips - min.z, between }
    }

    fn leg(&self, p: DVec3) -> Option<usize> {
        let side = |far: bool| usize::from(far);
        (p.z < self.hips).then(|| 2 * side(p.x > self.between.x) + side(p.y > self.between.y))
    }

    /// From the hips on downwards, each foot goes its own way by half the length of a leg.
    fn spread(&self, p: DVec3) -> DVec3 {
        let Some(leg) = self.leg(p) else { return p };
        let down = (self.hips - p.z) / self.length;
        let sign = |far: bool| if far { 1.0 } else { -1.0 };
        let way = DVec3::new(sign(leg >= 2), 0.6 * sign(leg % 2 == 1), 0.2 * leg as f64);
        p + 0.5 * self.length * down * down * way
    }
}
