//! Replaces the inertias in the text of a URDF: the `<inertial>` of every link that a joint moves is taken from a
//! robot, everything else is unchanged.

use palpate::Robot;
use palpate::unstable::{Link, LinkId};

use super::xml;

/// The text of a URDF with the masses and inertias of `robot`'s links.
///
/// # Errors
///
/// The end of a message, if the text is not XML or lacks one of the robot's moving links.
pub fn with_inertia(urdf: &str, robot: &Robot) -> Result<String, String> {
    let document = xml::parse(urdf)?;
    let mut changes: Vec<(std::ops::Range<usize>, String)> = Vec::new();
    for (index, link) in robot.links().iter().enumerate() {
        if robot.body_of(LinkId(index as u16)).is_none() {
            continue;
        }
        let element = (document.root_element().children())
            .find(|node| node.has_tag_name("link") && node.attribute("name") == Some(&link.name))
            .ok_or_else(|| format!("has no link `{}`", link.name))?;
        let inertial = element.children().find(|node| node.has_tag_name("inertial"));
        let text = if link.mass_kg > 0.0 { text_of(link) } else { String::new() };
        match inertial {
            Some(old) => changes.push((old.range(), text)),
            None if text.is_empty() => {}
            None => changes.push(inside(urdf, &element.range(), &text)),
        }
    }
    changes.sort_by_key(|(range, _)| range.start);
    let (mut out, mut done) = (String::with_capacity(urdf.len() + 4096), 0);
    for (range, text) in changes {
        out += &urdf[done..range.start];
        out += &text;
        done = range.end;
    }
    Ok(out + &urdf[done..])
}

/// The range of the URDF to replace, and its replacement, to insert `text` as the first child of a `<link>`.
fn inside(
    urdf: &str,
    element: &std::ops::Range<usize>,
    text: &str,
) -> (std::ops::Range<usize>, String) {
    let whole = &urdf[element.clone()];
    let end = element.start + whole.find('>').unwrap_or(0);
    if urdf[..end].ends_with('/') {
        let name = "link";
        return (end - 1..end + 1, format!(">\n    {text}\n  </{name}>"));
    }
    (end + 1..end + 1, format!("\n    {text}"))
}

fn text_of(link: &Link) -> String {
    let com = link.com_link_m;
    let tensor = link.inertia_com_kg_m2;
    format!(
        "<inertial>\n      <origin xyz=\"{} {} {}\" rpy=\"0 0 0\"/>\n      <mass value=\"{}\"/>\n      <inertia \
         ixx=\"{}\" ixy=\"{}\" ixz=\"{}\" iyy=\"{}\" iyz=\"{}\" izz=\"{}\"/>\n    </inertial>",
        com.x,
        com.y,
        com.z,
        link.mass_kg,
        tensor[(0, 0)],
        tensor[(0, 1)],
        tensor[(0, 2)],
        tensor[(1, 1)],
        tensor[(1, 2)],
        tensor[(2, 2)]
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const URDF: &str = r#"<robot name="r"><!-- kept --><link name="base"><inertial><mass value="9"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="arm"><inertial><origin xyz="0.1 0 0" rpy="0 0 1"/><mass value="2"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="2.5"/></inertial></link>
  <link name="tool"/>
  <joint name="a" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint>
  <joint name="b" type="continuous"><parent link="arm"/><child link="tool"/><axis xyz="1 0 0"/></joint></robot>"#;

    #[test]
    fn a_urdf_reads_back_with_the_inertias_that_were_written_into_it() {
        let robot = Robot::from_urdf(URDF).unwrap();
        let mut parameters = robot.inertial_parameters();
        parameters.iter_mut().enumerate().for_each(|(k, own)| *own += 0.01 * (k as f64 + 1.0));
        let text = with_inertia(URDF, &robot.with_inertial_parameters(&parameters)).unwrap();
        let back = Robot::from_urdf(&text).unwrap().inertial_parameters();
        assert!((back - parameters).amax() < 1e-12, "{text}");
        assert!(text.contains("<!-- kept -->") && text.contains("value=\"9\""), "{text}");
    }
}
