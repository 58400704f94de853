//! An E57 file once it is open.

use std::collections::BTreeMap;

use super::description::E57Description;
use super::fields::NumberEncoding;
use super::header::{E57Header, LENGTH};
use super::packets::{PacketWalk, Packets};
use super::pages::{DAMAGED, PageWindow, physical};
use super::scan::{NUMBER, Scan, TooWide};
use crate::follow::Following;
use crate::source::SourceFile;
use crate::{Attribute, Error, ModelInfo, Progress, Result, Scalar, Type, wkt};
use glam::DVec3;

/// Most points of which no field takes any bits: nothing in the file confirms their number.
const MOST_OF_NOTHING: u64 = 1 << 12;

/// An E57 file.
#[derive(Debug)]
pub struct E57Model {
    pub(super) source: SourceFile,
    pub(super) header: E57Header,
    /// Text of the file's XML: at most 64 MiB.
    pub(super) xml: String,
    /// The scans, in the order of their points in the file, which is that of the vertices.
    pub(super) scans: Vec<Scan>,
    pub(super) images: usize,
    /// The coordinate reference system as text, where that is more than its name.
    pub(super) wkt: Option<String>,
    /// Attributes that each scan has, as the index of the attribute and that of the scan's field; ascending.
    pub(super) attributes: Vec<Vec<(usize, usize)>>,
    /// Attributes that turn with the surface.
    pub(super) following: Following,
    pub(super) info: ModelInfo,
}

impl E57Model {
    /// Opens the file `source`: reads its XML and the heads of all packets, by which a file that is cut off
    /// is noticed.
    ///
    /// # Errors
    /// The file cannot be read, is not what E57 files are, or has a wrong checksum in what is read of it.
    pub fn new(source: SourceFile) -> Result<Self> {
        let header = E57Header::read(&source)?;
        let xml = read_xml(&source, &header)?;
        let E57Description { scans: described, images, crs } = E57Description::read(&source, &xml)?;
        let mut found = Vec::new();
        let number = described.len();
        let mut window = PageWindow::new(&source, 1);
        for one in described {
            let packets = if one.count == 0 {
                Packets::none()
            } else {
                let walk = PacketWalk { source: &source, window: &mut window, name: &one.name };
                Packets::find(walk, (one.place, one.count), &one.fields, number)?
            };
            found.push((one, packets));
        }
        found.sort_by_key(|(_, packets)| packets.section.start);
        let (mut scans, mut vertices) = (Vec::new(), 0u64);
        for (one, packets) in found {
            let (name, count) = (one.name.clone(), one.count);
            let Some(scan) = Scan::new(one, packets, vertices) else {
                let what =
                    format!("the points of {name} have no cartesianX, Y and Z, and no spherical coordinates");
                return Err(source.malformed(what, "export the scan with its positions"));
            };
            if scan.lead.is_none() && count > MOST_OF_NOTHING {
                let what = format!("{name} is said to have {count} points, of which no field takes any bits");
                return Err(source.malformed(what, DAMAGED));
            }
            vertices = vertices.checked_add(count).ok_or_else(|| {
                source.malformed("the scans are said to have more points than can be counted", DAMAGED)
            })?;
            scans.push(scan);
        }
        check_sections(&source, &header, &scans)?;
        // The name in WKT, or else all of a short text.
        let name = crs.as_deref().and_then(|text| wkt::name(text).or_else(|| wkt::short(text)));
        let wkt = crs.filter(|text| Some(text) != name.as_ref());
        let (info, attributes) = info(&source, &header, &scans, (vertices, name));
        let following = Following::recognised(&info.attributes);
        let mut this = Self { source, header, xml, scans, images, wkt, attributes, following, info };
        this.note_what_follows();
        Ok(this)
    }

    /// Tells each scan which of its fields turn.
    pub(super) fn note_what_follows(&mut self) {
        for (scan, attributes) in self.scans.iter_mut().zip(&self.attributes) {
            let field =
                |place: &usize| attributes.iter().find(|(known, _)| known == place).map(|(_, field)| *field);
            scan.turning = self.following.places().iter().map(field).collect();
        }
    }

    /// The scan that a vertex is of.
    pub(super) fn scan_of(&self, vertex: u64) -> usize {
        self.scans.partition_point(|scan| scan.vertices().end <= vertex)
    }

    pub(super) fn walk<'a, 'w>(
        &'a self,
        scan: &'a Scan,
        window: &'a mut PageWindow<'w>,
    ) -> PacketWalk<'a, 'w> {
        PacketWalk { source: &self.source, window, name: &scan.described.name }
    }

    /// See [`Model::make_room`](crate::Model::make_room).
    pub(super) fn choose_ranges(&mut self, moves: &[[DVec3; 2]], margin: f64) -> Result<Option<String>> {
        let refused = |what: String, hint: &str| {
            let what = format!("{}: {what}", self.source.path().display());
            Err(Error::degenerate(what, hint))
        };
        if self.info.step == DVec3::ZERO {
            let what = "its coordinates are floats, which reach everywhere".to_owned();
            return refused(what, "leave out --offset auto");
        }
        let mut chosen = Vec::new();
        for scan in &mut self.scans {
            if let Err(TooWide { field, ends: [least, most] }) = scan.make_room(moves, margin) {
                let field = &scan.described.fields[field];
                let (name, bits) = (&field.name, field.bits());
                let what = format!(
                    "{name} of {} goes from {least} to {most}, for which no range of {bits} bits is wide enough",
                    scan.described.name
                );
                return refused(what, "move it less, or export the model with coordinates as floats first");
            }
            for (field, [min, max]) in scan.other_ranges() {
                self.info.ranges.push([min, max]);
                let (name, scan) = (&scan.described.fields[field].name, &scan.described.name);
                chosen.push(format!("{name} of {scan} is {min} to {max}"));
            }
        }
        let changed =
            format!("ranges of integers become others: {}; these are written anew", chosen.join(", "));
        Ok((!chosen.is_empty()).then_some(changed))
    }

    /// Contents of the file that formats of points alone have no place for.
    pub(super) fn describe_besides(&self) -> Vec<String> {
        let number = |count: usize, one: &str| match count {
            1 => format!("1 {one}"),
            _ => format!("{count} {one}s"),
        };
        let mut besides = Vec::new();
        if self.scans.len() > 1 {
            besides.push(format!("which points are of which of {} scans, and their names", self.scans.len()));
        }
        let posed = self.scans.iter().filter(|scan| !scan.described.pose.is_identity()).count();
        if posed > 0 {
            besides.push(number(posed, "pose"));
        }
        let mut told: Vec<&str> = Vec::new();
        for name in self.scans.iter().flat_map(|scan| &scan.described.besides) {
            if !told.contains(&&**name) {
                told.push(name);
            }
        }
        if !told.is_empty() {
            besides.push(format!("what is told of scans: {}", told.join(", ")));
        }
        if self.scans.iter().any(Scan::has_spherical) {
            besides.push("spherical coordinates".to_owned());
        }
        let all = || self.scans.iter().flat_map(|scan| &scan.described.fields);
        let wide = all().filter(|field| field.is_beyond_doubles()).count();
        if wide > 0 {
            besides.push(format!("digits of {} of more than 53 bits", number(wide, "field")));
        }
        if self.images > 0 {
            besides.push(number(self.images, "image"));
        }
        let fields = self.scans.iter().flat_map(|scan| &scan.described.fields);
        let others = fields.filter(|field| !field.is_number()).count();
        if others > 0 {
            besides.push(format!("{} of points that are no numbers", number(others, "field")));
        }
        besides
    }

    /// Notes for the user that boxes of groups of points stay as they are, if there are any.
    pub(super) fn tell_of_groups(&self, progress: &dyn Progress) {
        if let Some(scan) = self.scans.iter().find(|scan| scan.described.has_boxes_of_groups) {
            progress.note(&format!(
                "{}: groups of points, as of {}, have boxes of their own, which are kept as they are",
                self.source.path().display(),
                scan.described.name
            ));
        }
    }

    /// Descriptions of the scans, one line each.
    pub(super) fn describe_scans(&self) -> Vec<String> {
        self.scans.iter().map(describe).collect()
    }

    /// Least and largest intensity of all scans with points, if all of these declare theirs.
    pub(super) fn intensities(&self) -> Option<[f64; 2]> {
        let with_points = self.scans.iter().map(|scan| &scan.described).filter(|scan| scan.count > 0);
        let limits: Option<Vec<[f64; 2]>> = with_points.map(|scan| scan.intensities).collect();
        limits?.into_iter().reduce(|[least, most], [a, b]| [least.min(a), most.max(b)])
    }
}

fn read_xml(source: &SourceFile, header: &E57Header) -> Result<String> {
    let mut window = PageWindow::new(source, 1);
    let bytes = window.get(header.xml.clone())?.to_vec();
    String::from_utf8(bytes).map_err(|e| {
        let at = physical(header.xml.start + e.utf8_error().valid_up_to() as u64);
        source.malformed(format!("the XML is no text in UTF-8 at byte {at}"), DAMAGED)
    })
}

fn describe(scan: &Scan) -> String {
    let described = &scan.described;
    let pose = &described.pose;
    let stands = match (pose.is_identity(), pose.rotation()) {
        (true, _) => "without a pose".to_owned(),
        (false, None) => format!("at {}", pose.translation),
        (false, Some((axis, angle))) => {
            format!("at {}, turned by {angle:.4}° about {axis:.6}", pose.translation)
        }
    };
    let mut text = format!("{}: {} points, {stands}", described.name, described.count);
    for field in scan.row.iter().map(|field| &described.fields[*field]) {
        if let NumberEncoding::Integer { scale, offset, .. } = field.kind
            && !field.name.ends_with("State")
        {
            let bits = field.bits();
            text += &format!("; {} in {bits} bits, with scale {scale} and offset {offset}", field.name);
        }
    }
    text
}

/// # Errors
/// The points of a scan lie over something else; the scans are in the order of the file.
fn check_sections(source: &SourceFile, header: &E57Header, scans: &[Scan]) -> Result<()> {
    let mut taken = (0..LENGTH, "the header");
    for scan in scans.iter().filter(|scan| scan.described.count > 0) {
        let (section, name) = (&scan.packets.section, &scan.described.name);
        let is_over_xml = section.start < header.xml.end && header.xml.start < section.end;
        if section.start < taken.0.end || is_over_xml {
            let other = if is_over_xml { "the XML" } else { taken.1 };
            let start = physical(section.start);
            let what = format!("the points of {name}, from byte {start} on, lie over {other}");
            return Err(source.malformed(what, DAMAGED));
        }
        taken = (section.clone(), name);
    }
    Ok(())
}

/// Attributes of all scans, and the indices of attribute and field for each scan.
fn attributes(scans: &[Scan], has_normals: bool) -> (Vec<Attribute>, Vec<Vec<(usize, usize)>>) {
    let mut attributes: Vec<Attribute> = Vec::new();
    let mut known = BTreeMap::new();
    let mut places = Vec::new();
    for scan in scans {
        let mut of_scan = BTreeMap::new();
        for index in scan.attributes(has_normals) {
            let field = &scan.described.fields[index];
            let name = match &*field.name {
                "colorRed" => "red",
                "colorGreen" => "green",
                "colorBlue" => "blue",
                name => name,
            };
            if !Attribute::is_name(name) {
                continue;
            }
            let kind = field.number_type();
            let attribute = *known.entry(name).or_insert(attributes.len());
            match attributes.get_mut(attribute) {
                Some(Attribute { kind: of_others, .. }) if *of_others != kind => *of_others = Type::F64,
                Some(_) => {}
                None => attributes.push(Attribute { name: name.to_owned(), kind }),
            }
            of_scan.entry(attribute).or_insert(index);
        }
        places.push(of_scan.into_iter().collect());
    }
    (attributes, places)
}

/// Returns the info of a model, and for each scan which of its fields each attribute is.
fn info(
    source: &SourceFile,
    header: &E57Header,
    scans: &[Scan],
    (vertices, crs): (u64, Option<String>),
) -> (ModelInfo, Vec<Vec<(usize, usize)>>) {
    let with_points = || scans.iter().filter(|scan| scan.described.count > 0);
    let has_normals = vertices > 0 && with_points().all(|scan| scan.has_normals);
    let is_single = |scan: &Scan| {
        let fields = scan.row.iter().take(3).map(|field| &scan.described.fields[*field]);
        fields.into_iter().all(|field| field.kind == NumberEncoding::Single)
            && scan.described.pose.is_identity()
    };
    let (attributes, places) = attributes(scans, has_normals);
    let number = match scans.len() {
        1 => "1 scan".to_owned(),
        scans => format!("{scans} scans"),
    };
    let vertex_bytes = scans.iter().map(|scan| scan.described.count * (scan.row.len() * NUMBER) as u64);
    let described = |a: &Attribute| format!("{} {}", a.kind.name(), a.name);
    let info = ModelInfo {
        format: format!("E57 {}.{}, {number}", header.version[0], header.version[1]),
        vertices,
        has_normals,
        position_type: if vertices > 0 && with_points().all(is_single) { Scalar::F32 } else { Scalar::F64 },
        other_properties: attributes.iter().map(described).collect(),
        attributes,
        bytes: source.len(),
        vertex_bytes: vertex_bytes.fold(0, u64::saturating_add),
        step: with_points()
            .map(Scan::step)
            .max_by(|a, b| a.length().total_cmp(&b.length()))
            .unwrap_or_default(),
        crs,
        ..ModelInfo::default()
    };
    (info, places)
}
