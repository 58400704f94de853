//! Description of the scans of an E57 file: its XML, and the places in the text of the limits of the scans'
//! coordinates.

use std::ops::Range;
use std::str::FromStr;

use glam::DVec3;
use roxmltree::{Document, Node, ParsingOptions};

use super::fields::{E57Field, NumberEncoding};
use super::pages::DAMAGED;
use super::pose::ScanPose;
use crate::source::SourceFile;
use crate::{Result, wkt};

/// Most elements, attributes and texts of the XML, which bounds the memory of its tree.
const MOST_NODES: u32 = 8 << 20;

/// A scan as it is described.
#[derive(Debug)]
pub(super) struct Described {
    /// Name of the scan: "scan 2", with its own name if it has one.
    pub name: String,
    pub count: u64,
    /// Place of the scan's points in the file.
    pub place: u64,
    /// Fields of the points, each with a stream of its own, in this order.
    pub fields: Vec<E57Field>,
    pub pose: ScanPose,
    pub slots: Vec<LimitSlot>,
    /// Places of the least and the largest number of each field in the text, if the text has them.
    pub limits: Vec<[Option<Range<usize>>; 2]>,
    /// Least and largest intensity that the scan declares, if it does.
    pub intensities: Option<[f64; 2]>,
    /// Groups of the scan's points, as lines of a scanner, have boxes of their own, which are in the groups'
    /// records.
    pub has_boxes_of_groups: bool,
    /// Names of the elements that describe the scan besides.
    pub besides: Vec<String>,
}

/// All scans, in the order of the text.
#[derive(Debug)]
pub(super) struct E57Description {
    pub scans: Vec<Described>,
    pub images: usize,
    /// Coordinate reference system of the file in one line, WKT or its name, if the file has one.
    pub crs: Option<String>,
}

/// A number that the points' coordinates do not go beyond.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Corner {
    /// Whether coordinates are range, azimuth and elevation; else they are x, y and z.
    pub is_spherical: bool,
    pub axis: usize,
    pub is_max: bool,
}

/// A place in the text that has such a number.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LimitSlot {
    pub corner: Corner,
    /// The number is a limit of the type of the field, which may be wider; else of the box of the points.
    pub is_limit: bool,
    /// The number as it is.
    pub value: f64,
    /// Type in which the number is written.
    pub kind: NumberEncoding,
    /// Range of the bytes to be replaced, and the text that has to stand around the new number.
    pub text: Range<usize>,
    pub around: (String, String),
}

impl E57Description {
    pub fn read(source: &SourceFile, xml: &str) -> Result<Self> {
        let options = ParsingOptions { nodes_limit: MOST_NODES, ..ParsingOptions::default() };
        let document = Document::parse_with_options(xml, options).map_err(|e| {
            source.malformed(format!("the XML that describes the scans cannot be read: {e}"), DAMAGED)
        })?;
        let reading = DescriptionReading { source, xml, document: &document };
        let root = document.root_element();
        if root.tag_name().name() != "e57Root" {
            let what = format!("its XML is of a <{}>, not of an <e57Root>", root.tag_name().name());
            return Err(source.malformed(what, DAMAGED));
        }
        let scans = child(root, "data3D").into_iter().flat_map(elements).enumerate();
        let scans = scans.map(|(i, node)| reading.scan(i, node)).collect::<Result<_>>()?;
        let crs = child(root, "coordinateMetadata").and_then(|node| node.text()).and_then(wkt::in_one_line);
        let images = child(root, "images2D").map_or(0, |images| elements(images).count());
        Ok(Self { scans, images, crs })
    }
}

fn elements<'a, 'i>(node: Node<'a, 'i>) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(Node::is_element)
}

fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    elements(node).find(|child| child.tag_name().name() == name && child.tag_name().namespace() == ns(node))
}

fn ns<'a>(node: Node<'a, '_>) -> Option<&'a str> {
    node.tag_name().namespace()
}

/// Names of a scan's elements that are not empty, but for its points, pose, and those that follow from the
/// points or say who made the file and when.
fn besides(scan: Node<'_, '_>) -> Vec<String> {
    const FOLLOWS: [&str; 9] = [
        "guid",
        "name",
        "pose",
        "points",
        "cartesianBounds",
        "sphericalBounds",
        "intensityLimits",
        "colorLimits",
        "indexBounds",
    ];
    const WHO_AND_WHEN: [&str; 3] = ["sensor", "acquisition", "originalGuids"];
    let is_told = |node: &Node<'_, '_>| {
        let name = node.tag_name().name();
        let has_text = |node: Node<'_, '_>| node.text().is_some_and(|text| !text.trim().is_empty());
        !FOLLOWS.contains(&name)
            && !WHO_AND_WHEN.iter().any(|start| name.starts_with(start))
            && node.descendants().any(has_text)
    };
    elements(scan).filter(is_told).map(|node| node.tag_name().name().chars().take(100).collect()).collect()
}

/// Whether groups of a scan's points have boxes in their records.
fn has_boxes_of_groups(scan: Node<'_, '_>) -> bool {
    let is_box = |node: Node<'_, '_>| matches!(node.tag_name().name(), "cartesianBounds" | "sphericalBounds");
    child(scan, "pointGroupingSchemes").is_some_and(|groups| groups.descendants().any(is_box))
}

struct DescriptionReading<'a, 'i> {
    source: &'a SourceFile,
    xml: &'i str,
    document: &'a Document<'i>,
}

impl<'a, 'i> DescriptionReading<'a, 'i> {
    fn wrong(&self, node: Node<'_, '_>, what: impl std::fmt::Display) -> crate::Error {
        let line = self.document.text_pos_at(node.range().start).row;
        self.source.malformed(format!("line {line} of its XML: {what}"), DAMAGED)
    }

    /// Refuses points that are packed by another codec than the one that every reader has to know.
    fn check_codecs(&self, points: Node<'a, 'i>, name: &str) -> Result<()> {
        let Some(codecs) = child(points, "codecs") else { return Ok(()) };
        let other = codecs.descendants().find(|node| {
            node.is_element() && node.tag_name().name().ends_with("Codec") && !node.has_tag_name(BITPACK)
        });
        let Some(other) = other else { return Ok(()) };
        let what = format!("{name} is compressed by the codec {:?}", other.tag_name().name());
        Err(self.wrong(other, what).hinting("export the model without, as usual programs write E57"))
    }

    /// Adds the places of a scan's bounds in the text, Cartesian and spherical ones. A bound that is no
    /// number is left as it is.
    fn add_bounds(&self, scan: Node<'a, 'i>, slots: &mut Vec<LimitSlot>) {
        for (element, names, is_spherical) in
            [("cartesianBounds", CARTESIAN_BOUNDS, false), ("sphericalBounds", SPHERICAL_BOUNDS, true)]
        {
            let Some(bounds) = child(scan, element) else { continue };
            for (i, name) in names.into_iter().enumerate() {
                let corner = Corner { is_spherical, axis: i / 2, is_max: i % 2 == 1 };
                slots.extend(child(bounds, name).and_then(|node| self.slot(node, corner).ok()));
            }
        }
    }

    /// Least and largest intensity that a scan says it can have; none where they are no numbers, or no range.
    fn intensity_limits(&self, scan: Node<'a, 'i>) -> Option<[f64; 2]> {
        let limits = child(scan, "intensityLimits")?;
        let end = |name| child(limits, name).and_then(|node| self.number(node).ok());
        let [least, most] = [end("intensityMinimum")?, end("intensityMaximum")?];
        (least < most && (most - least).is_finite()).then_some([least, most])
    }

    fn scan(&self, number: usize, node: Node<'a, 'i>) -> Result<Described> {
        let name = child(node, "name").and_then(|node| node.text()).unwrap_or_default().trim();
        let name: String = name.chars().filter(|c| !c.is_control()).take(100).collect();
        let number = number + 1;
        let name = if name.is_empty() { format!("scan {number}") } else { format!("scan {number} ({name})") };
        let Some(points) = child(node, "points") else {
            return Err(self.wrong(node, format!("{name} has no points")));
        };
        let count = self.attribute(points, "recordCount")?.unwrap_or(0);
        let place = self.attribute(points, "fileOffset")?.unwrap_or(0);
        let prototype = child(points, "prototype");
        let (mut slots, mut limits) = (Vec::new(), Vec::new());
        let fields = match prototype {
            Some(prototype) => self.fields(prototype, &mut slots, &mut limits)?,
            None => return Err(self.wrong(points, format!("the points of {name} have no prototype"))),
        };
        self.check_codecs(points, &name)?;
        self.add_bounds(node, &mut slots);
        let pose = self.pose(node, &name)?;
        let intensities = self.intensity_limits(node);
        let has_boxes_of_groups = has_boxes_of_groups(node);
        let besides = besides(node);
        Ok(Described {
            name,
            count,
            place,
            fields,
            pose,
            slots,
            limits,
            intensities,
            has_boxes_of_groups,
            besides,
        })
    }

    fn fields(
        &self,
        prototype: Node<'a, 'i>,
        slots: &mut Vec<LimitSlot>,
        limits: &mut Vec<[Option<Range<usize>>; 2]>,
    ) -> Result<Vec<E57Field>> {
        let mut fields = Vec::new();
        let all = prototype.descendants().skip(1).filter(Node::is_element);
        for node in all.filter(|node| node.attribute("type") != Some("Structure")) {
            let kind = self.kind(node)?;
            let local = node.tag_name().name();
            let namespace = ns(node).filter(|_| ns(node) != ns(prototype));
            let prefix = namespace.and_then(|uri| node.lookup_prefix(uri));
            let name = prefix.map_or_else(|| local.to_owned(), |prefix| format!("{prefix}:{local}"));
            let axis = |names: [&str; 3]| names.iter().position(|known| *known == name);
            let place = axis(CARTESIAN).map(|axis| (false, axis));
            let place = place.or(axis(SPHERICAL).map(|axis| (true, axis)));
            if let (Some((is_spherical, axis)), NumberEncoding::Single | NumberEncoding::Double) =
                (place, kind)
            {
                for (limit, is_max) in [("minimum", false), ("maximum", true)] {
                    let Some(value) = self.attribute::<f64>(node, limit)? else { continue };
                    let Some(attribute) = node.attribute_node(limit) else { continue };
                    slots.push(LimitSlot {
                        corner: Corner { is_spherical, axis, is_max },
                        is_limit: true,
                        value,
                        kind,
                        text: attribute.range_value(),
                        around: Default::default(),
                    });
                }
            }
            let place = |limit| node.attribute_node(limit).map(|attribute| attribute.range_value());
            limits.push([place("minimum"), place("maximum")]);
            fields.push(E57Field { name, kind });
        }
        Ok(fields)
    }

    fn kind(&self, node: Node<'a, 'i>) -> Result<NumberEncoding> {
        let kind = node.attribute("type").unwrap_or_default();
        match kind {
            "Float" => match node.attribute("precision") {
                None | Some("double") => Ok(NumberEncoding::Double),
                Some("single") => Ok(NumberEncoding::Single),
                Some(other) => Err(self.wrong(node, format!("the precision of a Float is {other:?}"))),
            },
            "Integer" | "ScaledInteger" => {
                let min = self.attribute(node, "minimum")?.unwrap_or(i64::MIN);
                let max = self.attribute(node, "maximum")?.unwrap_or(i64::MAX);
                let is_scaled = kind == "ScaledInteger";
                let number = |name| if is_scaled { self.attribute(node, name) } else { Ok(None) };
                let (scale, offset) = (number("scale")?.unwrap_or(1.0), number("offset")?.unwrap_or(0.0));
                let name = node.tag_name().name();
                if max < min {
                    return Err(self.wrong(node, format!("{name} has numbers from {min} to {max}")));
                }
                if !f64::is_finite(scale) || scale == 0.0 || !f64::is_finite(offset) {
                    return Err(self.wrong(node, format!("{name} has the scale {scale} and offset {offset}")));
                }
                Ok(NumberEncoding::Integer { min, max, scale, offset })
            }
            "String" => Ok(NumberEncoding::Other),
            other => {
                let what = format!("a point has {}, which is of the type {other:?}", node.tag_name().name());
                Err(self.wrong(node, what))
            }
        }
    }

    /// Pose of a scan. A scan without one is in the frame that all share.
    fn pose(&self, node: Node<'a, 'i>, scan: &str) -> Result<ScanPose> {
        let Some(pose) = child(node, "pose") else { return Ok(ScanPose::default()) };
        let numbers = |of: &str, names: [&str; 4], otherwise: [f64; 4]| {
            let mut numbers = otherwise;
            if let Some(node) = child(pose, of) {
                for (number, name) in numbers.iter_mut().zip(names) {
                    *number = child(node, name).map_or(Ok(0.0), |node| self.number(node))?;
                }
            }
            Ok(numbers)
        };
        let rotation = numbers("rotation", ["w", "x", "y", "z"], [1.0, 0.0, 0.0, 0.0])?;
        let [x, y, z, _] = numbers("translation", ["x", "y", "z", ""], [0.0; 4])?;
        let found = ScanPose::new(rotation, DVec3::new(x, y, z));
        found.ok_or_else(|| {
            let what = format!(
                "the pose of {scan} is no rigid motion: its rotation is {rotation:?} (w, x, y, z), its translation {:?}",
                [x, y, z]
            );
            self.wrong(pose, what).hinting("register the scan once more, or export it without a pose")
        })
    }

    /// An attribute that is a number.
    fn attribute<T: FromStr>(&self, node: Node<'a, 'i>, name: &str) -> Result<Option<T>> {
        let Some(text) = node.attribute(name) else { return Ok(None) };
        let number = text.trim().parse();
        number.map(Some).map_err(|_| {
            let element = node.tag_name().name();
            self.wrong(node, format!("{name}={text:?} of {element} is no number that it can be"))
        })
    }

    /// The number that an element has; zero if it is empty.
    fn number(&self, node: Node<'a, 'i>) -> Result<f64> {
        let text = node.text().unwrap_or_default().trim();
        let parsed = if text.is_empty() { Ok(0.0) } else { text.parse() };
        let number: f64 = parsed.map_err(|_| {
            self.wrong(node, format!("{:?} in {} is no number", text, node.tag_name().name()))
        })?;
        match self.kind(node) {
            Ok(NumberEncoding::Integer { scale, offset, .. }) => Ok(number * scale + offset),
            _ => Ok(number),
        }
    }

    fn slot(&self, node: Node<'a, 'i>, corner: Corner) -> Result<LimitSlot> {
        let value = self.number(node)?;
        let kind = self.kind(node)?;
        let mut around = Default::default();
        let text = match (node.first_child(), node.last_child()) {
            (Some(first), Some(last)) => first.range().start..last.range().end,
            _ => {
                // Without content: `<x/>`, or `<x></x>`, which becomes the same in the end.
                let all = node.range();
                let element = &self.xml[all.clone()];
                let ends = |c: char| c.is_whitespace() || c == '/' || c == '>';
                let name = element.get(1..).unwrap_or_default().split(ends).next().unwrap_or_default();
                around = (">".to_owned(), format!("</{name}>"));
                let end =
                    if element.ends_with("/>") { element.len() - 2 } else { element.find('>').unwrap_or(0) };
                all.start + end..all.end
            }
        };
        Ok(LimitSlot { corner, is_limit: false, value, kind, text, around })
    }
}

/// Codec that leaves numbers as they are, and is meant where the text names none.
const BITPACK: &str = "bitPackCodec";

pub(super) const CARTESIAN: [&str; 3] = ["cartesianX", "cartesianY", "cartesianZ"];
pub(super) const SPHERICAL: [&str; 3] = ["sphericalRange", "sphericalAzimuth", "sphericalElevation"];
const CARTESIAN_BOUNDS: [&str; 6] = ["xMinimum", "xMaximum", "yMinimum", "yMaximum", "zMinimum", "zMaximum"];
const SPHERICAL_BOUNDS: [&str; 6] =
    ["rangeMinimum", "rangeMaximum", "azimuthStart", "azimuthEnd", "elevationMinimum", "elevationMaximum"];
