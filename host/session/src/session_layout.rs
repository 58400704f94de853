//! A session that was changed, in the words of its file: comments, order, spaces and spellings stay wherever
//! the change has nothing to say.
//!
//! Three texts take part: the file as it stands, the same session as the program would write it (the base),
//! and the changed session as the program would write it. What differs between the last two is the change,
//! and only that is done to the first.

use std::collections::VecDeque;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::mem::take;
use toml_edit::{ArrayOfTables, DocumentMut, Item, RawString, Table, TableLike, Value};

/// Key that is never left out of a file, even where its value is what holds without it.
const STROKES: &str = "strokes";

/// Most pairs of tables that are compared to find the same ones; beyond, only those at both ends are.
const MOST_PAIRS: usize = 4_000_000;

/// Text of the file, with the differences between the base and the changed session.
pub(crate) fn changed(mut file: DocumentMut, base: &DocumentMut, mut to: DocumentMut) -> DocumentMut {
    // Without a version all is understood that there is.
    if !file.contains_key("version") {
        to.remove("version");
    }
    change_table(file.as_table_mut(), base.as_table(), to.into_table());
    unplace(file.as_table_mut());
    file
}

/// Changes a table of the file by key, to what `to` has.
fn change_table(file: &mut dyn TableLike, base: &dyn TableLike, to: Table) {
    let gone: Vec<String> = file
        .iter()
        .map(|(key, _)| key.to_owned())
        .filter(|key| !to.contains_key(key))
        // A key that the program leaves out says nothing new, and may well stand in the file.
        .filter(|key| base.contains_key(key) || key == STROKES)
        .collect();
    let end = end_of(file);
    for key in gone {
        file.remove(&key);
    }
    if let (Some(end), Some((_, Item::Value(last)))) = (end, file.iter_mut().last())
        && last.decor().suffix().and_then(RawString::as_str).is_none_or(str::is_empty)
    {
        last.decor_mut().set_suffix(end);
    }
    for (key, to) in to {
        match file.get_mut(&key) {
            Some(item) if !item.is_none() => change_item(item, base.get(&key), to),
            _ => drop(file.insert(&key, to)),
        }
    }
}

/// Text between the last value of a table in one line and the table's brace.
fn end_of(table: &dyn TableLike) -> Option<String> {
    let (_, last) = table.iter().last()?;
    let end = last.as_value()?.decor().suffix()?.as_str()?;
    Some(end.to_owned()).filter(|end| end.trim().is_empty())
}

fn change_item(file: &mut Item, base: Option<&Item>, to: Item) {
    if base.is_some_and(|base| is_same(base, &to)) || is_same(file, &to) {
        return;
    }
    match (file, base, to) {
        (Item::ArrayOfTables(file), Some(Item::ArrayOfTables(base)), Item::ArrayOfTables(to))
            if file.len() == base.len() =>
        {
            change_tables(file, base, to);
        }
        (file, Some(base), to) if file.is_table_like() && base.is_table_like() && to.is_table_like() => {
            if let (Some(file), Some(base), Ok(to)) =
                (file.as_table_like_mut(), base.as_table_like(), to.into_table())
            {
                change_table(file, base, to);
            }
        }
        (Item::Value(file), _, to) => {
            // A value is put where the former was, before the same comment.
            let decor = file.decor().clone();
            if let Ok(to) = to.into_value() {
                *file = to;
                *file.decor_mut() = decor;
            }
        }
        (file, _, to) => *file = to,
    }
}

/// Tables in a row, as steps: those that are the same stay, those that became others are changed, and the
/// rest comes and goes.
fn change_tables(file: &mut ArrayOfTables, base: &ArrayOfTables, to: ArrayOfTables) {
    let pairs = pairs(base, &to);
    let mut former: Vec<Option<Table>> = take(file).into_iter().map(Some).collect();
    for (to, from) in to.into_iter().zip(pairs) {
        let found = from.and_then(|from| Some((former.get_mut(from)?.take()?, base.get(from)?)));
        file.push(match found {
            Some((mut table, base)) => {
                change_table(&mut table, base, to);
                table
            }
            None => to,
        });
    }
}

/// Index of the former table that each of the new ones came from, if any: first those of the same content, in
/// order, and among the ones between two of these the next of the same kind.
fn pairs(base: &ArrayOfTables, to: &ArrayOfTables) -> Vec<Option<usize>> {
    let hashes = |tables: &ArrayOfTables| tables.iter().map(hash).collect::<Vec<_>>();
    let (before, after) = (hashes(base), hashes(to));
    let mut pairs = common(&before, &after);
    let is_taken = |pairs: &[Option<usize>], from| pairs.contains(&Some(from));
    for number in 0..pairs.len() {
        if pairs[number].is_none() {
            let first = pairs[..number].iter().rev().find_map(|pair| pair.map(|from| from + 1)).unwrap_or(0);
            let end = pairs[number..].iter().find_map(|pair| *pair).unwrap_or(before.len());
            let kind = to.get(number).map(kind);
            pairs[number] =
                (first..end).find(|from| !is_taken(&pairs, *from) && base.get(*from).map(self::kind) == kind);
        }
    }
    pairs
}

/// Index of the same former hash for each new one, in order: a longest common subsequence of what is between
/// the beginning and the end that both share.
fn common(before: &[u64], after: &[u64]) -> Vec<Option<usize>> {
    let start = before.iter().zip(after).take_while(|(a, b)| a == b).count();
    let rest = (&before[start..], &after[start..]);
    let end = rest.0.iter().rev().zip(rest.1.iter().rev()).take_while(|(a, b)| a == b).count();
    let middle = (&rest.0[..rest.0.len() - end], &rest.1[..rest.1.len() - end]);
    let mut found: VecDeque<Option<usize>> = (0..start).map(Some).collect();
    found.extend(subsequence(middle.0, middle.1).into_iter().map(|place| place.map(|place| start + place)));
    found.extend((before.len() - end..before.len()).map(Some));
    found.into()
}

/// The longest common subsequence by the table of lengths (R. A. Wagner and M. J. Fischer, *The
/// string-to-string correction problem*, 1974).
fn subsequence(before: &[u64], after: &[u64]) -> Vec<Option<usize>> {
    let (rows, columns) = (before.len(), after.len());
    let mut found = vec![None; columns];
    if rows.saturating_mul(columns) > MOST_PAIRS {
        return found;
    }
    // Lengths of the common subsequences of the rests from a row and a column on.
    let mut lengths = vec![0u32; (rows + 1) * (columns + 1)];
    let at = |row: usize, column: usize| row * (columns + 1) + column;
    for row in (0..rows).rev() {
        for column in (0..columns).rev() {
            lengths[at(row, column)] = if before[row] == after[column] {
                lengths[at(row + 1, column + 1)] + 1
            } else {
                lengths[at(row + 1, column)].max(lengths[at(row, column + 1)])
            };
        }
    }
    let (mut row, mut column) = (0, 0);
    while row < rows && column < columns {
        if before[row] == after[column] {
            found[column] = Some(row);
            (row, column) = (row + 1, column + 1);
        } else if lengths[at(row + 1, column)] >= lengths[at(row, column + 1)] {
            row += 1;
        } else {
            column += 1;
        }
    }
    found
}

/// Name of a table's kind, which tables of one kind share: the plugin of a step, the id of a joint, the role
/// of a region.
fn kind(table: &Table) -> Option<String> {
    let text = |key| table.get(key).and_then(Item::as_str).map(str::to_owned);
    text("deform").or_else(|| text("id")).or_else(|| text("role"))
}

fn hash(table: &Table) -> u64 {
    let mut hasher = DefaultHasher::new();
    table.to_string().hash(&mut hasher);
    hasher.finish()
}

/// Whether two items have the same value, however it is written.
fn is_same(a: &Item, b: &Item) -> bool {
    let value = |item: &Item| item.clone().into_value().ok();
    match (value(a), value(b)) {
        (Some(a), Some(b)) => is_same_value(&a, &b),
        _ => false,
    }
}

fn is_same_value(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::String(a), Value::String(b)) => a.value() == b.value(),
        (Value::Boolean(a), Value::Boolean(b)) => a.value() == b.value(),
        (Value::Datetime(a), Value::Datetime(b)) => a.value() == b.value(),
        (Value::Array(a), Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| is_same_value(a, b))
        }
        (Value::InlineTable(a), Value::InlineTable(b)) => {
            a.len() == b.len() && a.iter().all(|(key, a)| b.get(key).is_some_and(|b| is_same_value(a, b)))
        }
        (Value::Integer(a), Value::Integer(b)) => a.value() == b.value(),
        // A number is often given without its point.
        _ => matches!((number(a), number(b)), (Some(a), Some(b)) if a == b),
    }
}

fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|integer| integer as f64))
}

/// Removes the places of tables in the file, so that they stand where their keys do: new ones have no such
/// place.
fn unplace(table: &mut Table) {
    table.set_position(None);
    for (_, item) in table.iter_mut() {
        match item {
            Item::Table(table) => unplace(table),
            Item::ArrayOfTables(tables) => tables.iter_mut().for_each(unplace),
            Item::Value(_) | Item::None => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::SessionFile;
    use crate::motion::Motion;
    use crate::step::{Action, Deformation, HandleMove, Joint, Step};
    use glam::DVec3;
    use proptest::prelude::*;
    use simod_model::output::write_file;
    use std::path::Path;

    const FILE: &str = r#"# Bending the statue, for the catalogue.
version = 2

[output]
path = "./bent.ply" # beside it

[model] # as scanned
path = "statue.ply"

# First the head.
[[step]]
deform = "warp"   # the usual one
enabled = true
params = { angle = 30, axis = [0, 0, 1], mode = 'bend' }

# Then the hands.
[[step]]
deform = "skinning"

[[step.joint]]
at = [0, 0, 0] # the wrist
id = "a"

[[step.handle]]
id = "a"
move = { degrees = 20, axis = [1, 0, 0] }

[[step]]
# Where it was too coarse.
refine = { factor = 4, shapes = [
    { sphere = { center = [0, 0, 0], radius = 1 } }, # the head
] }

# The end.
"#;

    /// Text that is written over the file after this change.
    fn saved(file: &str, change: impl FnOnce(&mut SessionFile)) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("edit.toml");
        write_file(&path, file.as_bytes()).unwrap();
        let mut session = SessionFile::load(&path).unwrap();
        change(&mut session);
        session.save_over(&path, &path).unwrap();
        let plain = |session: SessionFile| session.to_toml(&path).unwrap();
        assert_eq!(plain(SessionFile::load(&path).unwrap()), plain(session));
        std::fs::read_to_string(&path).unwrap()
    }

    fn deformation(session: &mut SessionFile, step: usize) -> &mut Deformation {
        match &mut session.steps[step].action {
            Action::Deform(deformation) => deformation,
            Action::Refine(_) => panic!("a deformation"),
        }
    }

    #[test]
    fn what_did_not_change_is_as_it_was() {
        assert_eq!(saved(FILE, |_| ()), FILE);
        assert_eq!(saved("version = 2\n# Nothing yet.\n", |_| ()), "version = 2\n# Nothing yet.\n");
        assert_eq!(saved("# Nothing yet.\n", |_| ()), "# Nothing yet.\n");
    }

    #[test]
    fn a_value_that_changes_is_put_in_its_place() {
        let text = saved(FILE, |session| {
            drop(deformation(session, 0).params.insert("angle".into(), 45.0.into()));
            deformation(session, 1).handles[0].motion.degrees = 25.0;
            session.steps[2].enabled = false;
            session.model = session.model.take().map(|model| model.with_file_name("other.ply"));
        });
        let expected = FILE
            .replace("angle = 30", "angle = 45.0")
            .replace("degrees = 20", "degrees = 25.0")
            .replace("statue.ply", "other.ply");
        let refine = expected.rfind("] }\n").unwrap();
        let expected = format!("{}] }}\nenabled = false\n{}", &expected[..refine], &expected[refine + 4..]);
        assert_eq!(text, expected);
    }

    #[test]
    fn steps_come_go_and_change_places_with_their_comments() {
        let text = saved(FILE, |session| {
            session.steps.insert(1, Step::new(Action::Deform(Deformation::by_plugin("rbf"))));
        });
        let (first, second) =
            (text.find("# First the head.").unwrap(), text.find("# Then the hands.").unwrap());
        let between = &text[first..second];
        assert!(between.contains("deform = \"rbf\""), "{text}");
        assert_eq!(text.replace("\n[[step]]\ndeform = \"rbf\"\n", ""), FILE);

        let text = saved(FILE, |session| drop(session.steps.remove(0)));
        assert!(!text.contains("First the head") && text.contains("# Then the hands."), "{text}");
        assert!(text.contains("# Where it was too coarse.") && text.ends_with("# The end.\n"), "{text}");

        let text = saved(FILE, |session| session.steps.rotate_left(1));
        let [warp, skinning, refine] =
            ["\"warp\"", "\"skinning\"", "refine ="].map(|what| text.find(what).unwrap());
        assert!(skinning < refine && refine < warp, "{text}");
        assert!(
            text.contains("# Then the hands.") && text.contains("{ sphere = { center = [0, 0, 0]"),
            "{text}"
        );
    }

    #[test]
    fn what_goes_takes_no_other_with_it() {
        let text = saved(FILE, |session| {
            let skinning = deformation(session, 1);
            skinning.handles.clear();
            skinning.handles.push(HandleMove {
                id: "b".into(),
                motion: Motion { translate: DVec3::X, ..Motion::default() },
            });
            deformation(session, 0).params.remove("mode");
            session.output = None;
        });
        assert!(!text.contains("[output]") && !text.contains("mode ="), "{text}");
        assert!(text.contains("axis = [0, 0, 1] }"), "{text}");
        assert!(text.contains("at = [0, 0, 0] # the wrist\nid = \"a\""), "{text}");
        assert!(text.contains("id = \"b\"\nmove = { translate = [1.0, 0.0, 0.0] }"), "{text}");
    }

    #[test]
    fn a_session_in_other_words_stays_in_them() {
        let inline = "step = [{ deform = \"warp\", params.angle = 1 }, { deform = \"rbf\" }]\n\
            model.path = \"a.ply\" # the model\nmodel.fingerprint = \"x\"\n";
        assert_eq!(saved(inline, |_| ()), inline);
        let text = saved(inline, |session| session.fingerprint = Some("y".into()));
        assert_eq!(text, inline.replace("\"x\"", "\"y\""));
        let text = saved(inline, |session| session.steps[1].enabled = false);
        assert!(text.contains("model.path = \"a.ply\" # the model"), "{text}");
        let dotted =
            "[[step]]\ndeform = \"warp\"\n[step.params]\n# In degrees.\nangle = 1\nmode = \"bend\"\n";
        let text =
            saved(dotted, |session| drop(deformation(session, 0).params.insert("angle".into(), 2.0.into())));
        assert_eq!(text, dotted.replace("angle = 1", "angle = 2.0"));
    }

    #[test]
    fn strokes_that_go_do_not_stay_in_their_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("edit.toml");
        let mut painting = Deformation::by_plugin("displacement-paint");
        let stroke = crate::step::Stroke {
            radius: 1.0,
            strength: 1.0,
            points: vec![DVec3::ZERO; 5000],
            pressures: Vec::new(),
            params: toml::Table::new(),
        };
        painting.strokes = vec![stroke.into()];
        let mut session =
            SessionFile { steps: vec![Step::new(Action::Deform(painting))], ..SessionFile::default() };
        session.save(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains("strokes = {"), "{text}");
        session.save_over(&path, &path).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        deformation(&mut session, 0).strokes.clear();
        session.save_over(&path, &path).unwrap();
        assert!(!std::fs::read_to_string(&path).unwrap().contains("stroke"));
    }

    /// Joints are read in another order than they may stand in.
    #[test]
    fn joints_in_any_order_are_those_that_are_meant() {
        let joint =
            |id: &str, at: &str, rest: &str| format!("[[step.joint]]\nid = \"{id}\"\nat = {at}\n{rest}");
        let hand = joint("hand", "[1, 0, 0]", "parent = \"arm\"\n");
        let file =
            format!("# A hand.\n[[step]]\ndeform = \"skinning\"\n{hand}{}", joint("arm", "[0, 0, 0]", ""));
        assert_eq!(saved(&file, |_| ()), file);
        let text = saved(&file, |session| {
            let hand = deformation(session, 0).joints.iter_mut().find(|joint| joint.id == "hand").unwrap();
            hand.at = DVec3::X * 2.0;
        });
        assert!(text.contains("id = \"hand\"\nat = [2.0, 0.0, 0.0]\nparent = \"arm\""), "{text}");
    }

    #[test]
    fn files_are_named_as_seen_from_where_the_session_goes() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().canonicalize().unwrap();
        let (path, other) = (folder.join("edit.toml"), folder.join("sub").join("edit.toml"));
        std::fs::create_dir(folder.join("sub")).unwrap();
        write_file(&path, FILE.as_bytes()).unwrap();
        let session = SessionFile::load(&path).unwrap();
        session.save_over(&other, &path).unwrap();
        let text = std::fs::read_to_string(&other).unwrap();
        assert!(text.contains("path = \"../statue.ply\"") && text.contains("# as scanned"), "{text}");
        let there = SessionFile::load(&other).unwrap();
        assert_eq!(there.named_output.as_deref(), Some(Path::new("../bent.ply")));
    }

    #[test]
    fn a_former_file_that_is_no_session_is_written_over() {
        let folder = tempfile::tempdir().unwrap();
        let (path, former) = (folder.path().join("edit.toml"), folder.path().join("former.toml"));
        let session =
            SessionFile { fingerprint: Some("x".into()), model: Some("a".into()), ..Default::default() };
        session.save(&path).unwrap();
        let plain = std::fs::read_to_string(&path).unwrap();
        for text in [None, Some("version = 7"), Some("[[["), Some("a = 1")] {
            match text {
                Some(text) => write_file(&former, text.as_bytes()).unwrap(),
                None => assert!(!Path::new(&former).exists()),
            }
            session.save_over(&path, &former).unwrap();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), plain);
        }
    }
    /// Steps of a few plugins with a few values, in which many are the same or nearly so.
    fn steps() -> impl Strategy<Value = Vec<Step>> {
        let step = (0..3u8, 0..3i64, 0..3usize).prop_map(|(plugin, value, joints)| {
            let mut deformation = Deformation::by_plugin(&format!("p{plugin}"));
            if value > 0 {
                deformation.params.insert("value".into(), value.into());
            }
            deformation.joints = (0..joints)
                .map(|i| Joint { id: format!("j{i}"), at: DVec3::splat(value as f64), parent: None })
                .collect();
            Step::new(Action::Deform(deformation))
        });
        prop::collection::vec(step, 0..7)
    }

    proptest! {
        /// A session that is changed in any way is written as it is meant, and comments are each there once
        /// at most.
        #[test]
        fn what_is_written_over_a_file_is_what_was_meant(before in steps(), after in steps()) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("edit.toml");
            let [before, after] = [before, after].map(|steps| SessionFile { steps, ..SessionFile::default() });
            let mut number = 0;
            let numbered = |line: &str| {
                number += usize::from(line.starts_with('['));
                if line.starts_with('[') { format!("# {number}.\n{line}\n") } else { format!("{line}\n") }
            };
            let text: String = before.to_toml(&path).unwrap().lines().map(numbered).collect();
            write_file(&path, text.as_bytes()).unwrap();
            after.save_over(&path, &path).unwrap();
            let written = std::fs::read_to_string(&path).unwrap();
            let plain = after.to_toml(&path).unwrap();
            prop_assert_eq!(SessionFile::parse(&written, &path).unwrap().to_toml(&path).unwrap(), plain);
            for comment in (1..=number).map(|number| format!("# {number}.\n")) {
                prop_assert!(written.matches(&comment).count() <= 1, "{}", written);
            }
            before.save_over(&path, &path).unwrap();
            let again = SessionFile::load(&path).unwrap().to_toml(&path).unwrap();
            prop_assert_eq!(again, before.to_toml(&path).unwrap());
        }
    }
}
