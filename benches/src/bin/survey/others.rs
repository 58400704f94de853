//! Tools that take no handles, which have pictures alone: a row for each.

use std::path::Path;
use std::process::Command;

use simod_benches::process::{Result, report};
use simod_generate::{ModelOptions, write_file};
use simod_model::progress::Silent;

use crate::cases::{CASES, Case};
use crate::pictures::Gallery;
use crate::sessions;

/// A tool on the shape of a case.
struct Other {
    tool: &'static str,
    case: &'static Case,
    /// Samples of the case that its session `CASE` and this deforms, for tools that take what others have
    /// made.
    samples: Option<&'static str>,
    /// Pictures: for each its caption, and the session `CASE-KEY.toml` that makes it.
    results: &'static [[&'static str; 2]],
}

const OTHERS: [Other; 3] = [
    Other {
        tool: "smooth",
        case: &CASES[0],
        samples: None,
        results: &[
            ["low-pass", "low-pass"],
            ["mean curvature flow", "flow"],
            ["made to stand out", "amplified"],
        ],
    },
    Other {
        tool: "blendshapes",
        case: &CASES[0],
        samples: Some(""),
        results: &[["by a half", "half"], ["by 1.3", "exaggerated"]],
    },
    Other {
        tool: "register",
        case: &CASES[3],
        samples: None,
        results: &[["the other model", "target"], ["register", "register"]],
    },
];

/// Draws the results of these tools into a folder, or of those of the names in `only`.
pub fn draw(
    simod: &Path,
    (vertices, only): (u64, &[String]),
    from: &Path,
    temporary: &Path,
    pictures: &Path,
) -> Result<()> {
    for other in OTHERS.iter().filter(|other| only.is_empty() || only.iter().any(|only| only == other.tool)) {
        let folder = tempfile::tempdir_in(temporary)?;
        other.draw(simod, vertices, (from, folder.path()), pictures)?;
    }
    Ok(())
}

impl Other {
    fn draw(
        &self,
        simod: &Path,
        vertices: u64,
        (from, folder): (&Path, &Path),
        pictures: &Path,
    ) -> Result<()> {
        let name = self.case.name;
        let at = |file: &str| folder.join(format!("{name}{file}"));
        let options = ModelOptions { shape: self.case.shape, vertices, ..ModelOptions::default() };
        write_file(&options, &at(".ply"), &Silent)?;
        sessions::copy(from, folder)?;
        sessions::copy(&from.join("others"), folder)?;
        if let Some(key) = self.samples {
            let sample = ["--samples", "20000"];
            report(
                Command::new(simod).arg("sample").arg(at(".ply")).args(sample).arg("-o").arg(at(".simod")),
            )?;
            let session = at(&format!("{key}.toml"));
            let mut deform = Command::new(simod);
            deform
                .arg("deform")
                .arg(at(".simod"))
                .arg("--session")
                .arg(session)
                .arg("-o")
                .arg(at("-samples.ply"));
            report(&mut deform)?;
        }
        let first = self.results.first().map_or("", |[_, key]| key);
        let mut gallery = Gallery::new(self.case, &at(&format!("-{first}.toml")))?;
        gallery.add("at rest", &at(".ply"))?;
        for [caption, key] in self.results {
            let output = at(&format!("-{key}.edited.ply"));
            report(Command::new(simod).arg("run").arg(at(&format!("-{key}.toml"))).arg("-o").arg(&output))?;
            gallery.add(caption, &output)?;
        }
        gallery.write(&pictures.join(format!("methods-{}.png", self.tool)))
    }
}
