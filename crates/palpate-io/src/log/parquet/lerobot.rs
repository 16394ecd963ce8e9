//! Joint names of a LeRobot data set, from its `meta/info.json` (versions 2 and 3).

use std::path::Path;

use serde_json::Value;

use crate::input;

/// Largest size of `info.json`, bytes.
const LARGEST: u64 = 16 << 20;
/// Number of folders above a file of frames in which `meta/info.json` is searched: `data/chunk-000` and the data set.
const DEPTH: usize = 3;
/// Suffixes of names in a list, after the name of the joint.
const ENDINGS: [&str; 7] =
    [".pos", ".position", ".effort", ".torque", "_pos", "_effort", "_torque"];

/// The joints that are in both lists, of positions and of torques, and their indices in each.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Joints {
    pub(super) names: Vec<String>,
    pub(super) q: Vec<usize>,
    pub(super) tau: Vec<usize>,
}

/// The joints of the data set that a file of frames belongs to. `None` without a data set, without common names, or if
/// the names only count and so say nothing beyond the order. The error is the end of a message about `info.json`.
pub(super) fn joints(file: &Path, q: &str, tau: &str) -> Result<Option<Joints>, String> {
    let whole = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
    let folders = whole.ancestors().skip(1).take(DEPTH);
    let Some(path) =
        folders.map(|folder| folder.join("meta/info.json")).find(|path| path.is_file())
    else {
        return Ok(None);
    };
    let in_words = |why: String| format!("`{}` {why}", path.display());
    let text = input::read_text(&path, LARGEST)
        .map_err(|error| in_words(format!("cannot be read: {error}")))?;
    let info: Value = serde_json::from_str(&text)
        .map_err(|error| in_words(format!("is not valid JSON: {error}")))?;
    let of = |feature: &str| names(&info["features"][feature]["names"]);
    let (Some(q), tau) = (of(q), of(tau)) else { return Ok(None) };
    let tau = tau.unwrap_or_else(|| q.clone());
    let place = |names: &[String], name: &String| names.iter().position(|held| held == name);
    let names: Vec<String> = q.iter().filter(|name| tau.contains(name)).cloned().collect();
    let numbers: Option<Vec<u32>> = names.iter().map(|name| number(name)).collect();
    let count_up = numbers.is_some_and(|numbers| numbers.is_sorted());
    if names.is_empty() || (q == tau && count_up) {
        return Ok(None); // the names say nothing beyond the order
    }
    let places = |of: &[String]| names.iter().filter_map(|name| place(of, name)).collect();
    Ok(Some(Joints { q: places(&q), tau: places(&tau), names }))
}

/// The names in a list, or in the only list of an object, `{"motors": [...]}`, without the suffixes [`ENDINGS`].
fn names(value: &Value) -> Option<Vec<String>> {
    let list = match value {
        Value::Object(kinds) if kinds.len() == 1 => kinds.values().next()?,
        other => other, // `None` below for several lists: their order is not known
    };
    let bare = |name: &Value| {
        let name = name.as_str()?;
        let bare = ENDINGS.iter().find_map(|ending| name.strip_suffix(ending)).unwrap_or(name);
        Some(bare.to_owned())
    };
    list.as_array()?.iter().map(bare).collect()
}

/// The number of a name that is only a number, or a number after a general word such as `motor` or `joint`.
fn number(name: &str) -> Option<u32> {
    let words = ["motor", "joint", "state", "axis", "dim", "j", "q", "m"];
    let name = name.to_ascii_lowercase();
    let rest = words.iter().find_map(|word| name.strip_prefix(word)).unwrap_or(&name);
    rest.trim_start_matches(['_', '.', '-', ' ']).parse().ok()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn joints_of(q: &str, tau: &str) -> Result<Option<Joints>, String> {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir_all(folder.path().join("meta")).unwrap();
        fs::create_dir_all(folder.path().join("data/chunk-000")).unwrap();
        let info =
            format!("{{\"features\": {{\"s\": {{\"names\": {q}}}, \"e\": {{\"names\": {tau}}}}}}}");
        fs::write(folder.path().join("meta/info.json"), info).unwrap();
        joints(&folder.path().join("data/chunk-000/file-000.parquet"), "s", "e")
    }

    #[test]
    fn joints_of_both_lists_are_found_by_name_whatever_their_order() {
        let found = joints_of(
            r#"["a.pos", "b.pos", "gripper.pos"]"#,
            r#"{"motors": ["b.effort", "a.effort"]}"#,
        );
        let wanted = Joints { names: vec!["a".into(), "b".into()], q: vec![0, 1], tau: vec![1, 0] };
        assert_eq!(found, Ok(Some(wanted)));
        let found = joints_of(r#"{"motors": ["a", "b"]}"#, "null").unwrap().unwrap();
        assert_eq!((found.q, found.tau), (vec![0, 1], vec![0, 1]));
    }

    #[test]
    fn names_that_only_count_are_ignored_and_broken_metadata_is_reported() {
        let two_lists = r#"{"motors": ["a", "b"], "gripper": ["g"]}"#;
        for names in [
            r#"["motor_0", "motor_1"]"#,
            r#"["0", "1"]"#,
            r#"["J1", "J2"]"#,
            "null",
            "[3]",
            two_lists,
        ] {
            assert_eq!(joints_of(names, names), Ok(None), "{names}");
        }
        // Numbers are used if they differ from the order in the lists.
        let (up, down) = (r#"["joint_1", "joint_2"]"#, r#"["joint_2", "joint_1"]"#);
        assert_eq!(joints_of(up, down).unwrap().unwrap().tau, [1, 0]);
        assert_eq!(joints_of(down, down).unwrap().unwrap().names, ["joint_2", "joint_1"]);
        assert_eq!(
            joints_of(r#"["joint_1", "joint_2", "gripper"]"#, up).unwrap().unwrap().q,
            [0, 1]
        );
        assert!(joints_of("[", "1").unwrap_err().contains("meta/info.json` is not valid JSON"));
        assert_eq!(joints(Path::new("/nowhere/data/file.parquet"), "s", "e"), Ok(None));
    }
}
