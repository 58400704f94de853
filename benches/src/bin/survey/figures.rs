//! The figures of one result.

use std::path::Path;
use std::process::Command;

use glam::DVec3;
use simod_benches::median;
use simod_benches::process::{Result, number, phase, report};
use simod_generate::Surface;
use simod_measure::{DetailRotation, Details, Edges, Spread, area_distortion, edge_distortion, volume};

use crate::cases::Case;

/// Length over which the surface is smoothed that triangles are compared with where a shape has no details.
const SMOOTH: f64 = 0.04;

/// A shape at rest.
pub struct Subject<'a> {
    case: &'a Case,
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

/// Figures of what a deformation does to a shape; see [`simod_measure`].
pub struct Figures {
    /// Relative change, where the shape is closed.
    volume: Option<f64>,
    edges: Spread,
    areas: Spread,
    rotation: DetailRotation,
    has_details: bool,
    /// Seconds.
    prepare: f64,
    deform: f64,
    pub samples: f64,
}

impl<'a> Subject<'a> {
    pub fn new(case: &'a Case, vertices: u64) -> Result<Self> {
        let (vertices, triangles) = Surface::new(case.shape, vertices)?.mesh()?;
        Ok(Self { case, positions: vertices.iter().map(|v| v.position).collect(), triangles })
    }

    pub fn vertices(&self) -> usize {
        self.positions.len()
    }
}

/// Runs a session some times, and measures its result.
pub fn measure(
    subject: &Subject<'_>,
    simod: &Path,
    session: &Path,
    output: &Path,
    runs: u32,
) -> Result<Figures> {
    let (mut prepare, mut deform, mut samples) = (Vec::new(), Vec::new(), 0.0);
    for _ in 0..runs {
        let report = report(Command::new(simod).arg("run").arg(session).arg("-o").arg(output))?;
        prepare.push(phase(&report, "preparing the deformation")?);
        deform.push(phase(&report, "deforming")?);
        samples = number(&report, "samples")?;
    }
    let mut deformed = Vec::with_capacity(subject.vertices());
    simod_model::for_vertices(simod_model::open(output)?.as_ref(), |chunk| {
        deformed.extend_from_slice(&chunk.positions);
        Ok(())
    })?;
    let Subject { case, positions: rest, triangles } = subject;
    let change = || volume(&deformed, triangles) / volume(rest, triangles) - 1.0;
    Ok(Figures {
        volume: case.is_closed.then(change),
        edges: edge_distortion(rest, &deformed, &Edges::from_triangles(rest, triangles)),
        areas: area_distortion(rest, &deformed, triangles),
        rotation: Details::new(rest, triangles, case.details.unwrap_or(SMOOTH)).rotation(&deformed),
        has_details: case.details.is_some(),
        prepare: median(prepare),
        deform: median(deform),
        samples,
    })
}

impl Figures {
    /// As a table has them.
    pub fn cells(&self) -> [String; 8] {
        let percent = |x: f64| format!("{:.1} %", 100.0 * x);
        [
            self.volume.map_or("—".to_owned(), |x| format!("{:+.1} %", 100.0 * x)),
            percent(self.edges.rms),
            percent(self.edges.p99),
            percent(self.areas.rms),
            if self.has_details { format!("{:.1}°", self.rotation.rms) } else { "—".to_owned() },
            self.rotation.folded.to_string(),
            format!("{:.0}", 1e3 * self.prepare),
            format!("{:.0}", 1e3 * self.deform),
        ]
    }
}
