//! `simod generate`: models of any size to try things on, without any download.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use glam::DVec3;
use simod_core::guard::OutputKind;
use simod_generate::{ModelOptions, PlyEncoding, Shape, write_file};
use simod_model::{Result, Scalar};

use super::overwrite::Overwrite;
use crate::report::{Report, count, rate};

/// Write a generated model of any size
#[derive(Args)]
pub struct Generate {
    /// PLY file to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Number of vertices, which is met to 2 %
    #[arg(long, default_value_t = 2_000_000, value_name = "N")]
    vertices: u64,
    /// Shape of the model
    #[arg(long, value_enum, default_value_t)]
    shape: ShapeName,
    /// Encoding of the file
    #[arg(long, value_enum, default_value_t)]
    encoding: EncodingName,
    /// Write positions in double precision, instead of single
    #[arg(long)]
    double: bool,
    /// Leave the normals out
    #[arg(long)]
    no_normals: bool,
    /// Leave the colours out
    #[arg(long)]
    no_colors: bool,
    /// Leave the faces out, so that the model is a point cloud
    #[arg(long)]
    no_faces: bool,
    /// Offset to add to all positions, as 500000,4649776,120
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,0", hide_default_value = true)]
    #[arg(value_parser = parse_offset, allow_hyphen_values = true)]
    offset: DVec3,
    #[command(flatten)]
    overwrite: Overwrite,
}

fn parse_offset(text: &str) -> std::result::Result<DVec3, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let numbers = numbers.and_then(|n| <[f64; 3]>::try_from(n).ok()).map(DVec3::from_array);
    numbers
        .filter(|p| p.is_finite())
        .ok_or_else(|| "an offset is three numbers, as 500000,4649776,120".to_owned())
}

/// The shapes that there are.
#[derive(Clone, Copy, Default, ValueEnum)]
enum ShapeName {
    /// A painted amphora with rope handles, fluting and engraved letters
    #[default]
    Amphora,
    /// A sphere with waves
    BumpySphere,
    /// A square with long and short waves
    Plane,
    /// A square with a hundred bumps
    BumpyPlane,
    /// A round bar
    Cylinder,
    /// A square bar with sharp edges
    Bar,
    /// A stem with two bent arms, ribs and bumps
    Cactus,
}

/// Encoding of the numbers in the file.
#[derive(Clone, Copy, Default, ValueEnum)]
enum EncodingName {
    /// Text
    Ascii,
    /// Binary numbers, least significant byte first
    #[default]
    LittleEndian,
    /// Binary numbers, most significant byte first
    BigEndian,
}

impl Generate {
    pub fn execute(self, report: &mut Report) -> Result<()> {
        let options = ModelOptions {
            shape: match self.shape {
                ShapeName::Amphora => Shape::Amphora,
                ShapeName::BumpySphere => Shape::BumpySphere,
                ShapeName::Plane => Shape::Plane,
                ShapeName::BumpyPlane => Shape::BumpyPlane,
                ShapeName::Cylinder => Shape::Cylinder,
                ShapeName::Bar => Shape::Bar,
                ShapeName::Cactus => Shape::Cactus,
            },
            vertices: self.vertices,
            encoding: match self.encoding {
                EncodingName::Ascii => PlyEncoding::Ascii,
                EncodingName::LittleEndian => PlyEncoding::BinaryLittleEndian,
                EncodingName::BigEndian => PlyEncoding::BinaryBigEndian,
            },
            scalar: if self.double { Scalar::F64 } else { Scalar::F32 },
            normals: !self.no_normals,
            colors: !self.no_colors,
            faces: !self.no_faces,
            offset: self.offset,
        };
        self.overwrite.guard().writes(&self.output, OutputKind::Model)?;
        let info = write_file(&options, &self.output, report.progress())?;
        report.figure("vertices", info.vertices);
        report.figure("faces", info.faces);
        report.figure("bytes", info.bytes);
        report.line(format!(
            "{} vertices, {} faces, {} bytes in {}, {}",
            count(info.vertices),
            count(info.faces),
            count(info.bytes),
            self.output.display(),
            rate(info.vertices, report.seconds())
        ));
        Ok(())
    }
}
