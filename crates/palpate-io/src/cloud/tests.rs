//! Every variant of PLY and PCD gives the same cloud, and everything else an error.

use super::*;
use nalgebra::Point3;
use proptest::prelude::*;

fn reading(bytes: &[u8]) -> Result<CloudFile, CloudError> {
    decode(bytes, Path::new("leaf"))
}

fn failure(bytes: &[u8]) -> String {
    reading(bytes).unwrap_err().to_string()
}

fn leaf() -> Cloud {
    let points = vec![Point3::new(0.5, -0.25, 1.5), Point3::new(0.0, 2.0, -8.0)];
    Cloud::new(points, Some(vec![[255, 0, 51], [1, 2, 3]]))
}

/// The leaf as a binary PLY with additional data: an element with a list before the vertices, a
/// list and a number between their coordinates, truncated faces after them.
fn crowded_ply(big_endian: bool) -> Vec<u8> {
    let order = if big_endian { "big" } else { "little" };
    let mut bytes = format!(
        "ply\r\nformat binary_{order}_endian 1.0\r\ncomment of a lime\r\n\
         element camera 2\nproperty list uchar short view\n\
         element nothing 999999999999\n\
         element vertex 2\nproperty double x\nproperty list ushort float weights\n\
         property float32 y\nproperty uint8 red\nproperty char quality\nproperty float z\n\
         property uchar green\nproperty uchar blue\n\
         element face 1000\nproperty list uchar int vertex_indices\nend_header\n"
    )
    .into_bytes();
    let mut put = |little: &[u8]| {
        let mut number = little.to_vec();
        if big_endian {
            number.reverse();
        }
        bytes.extend(number);
    };
    for length in [3u8, 0] {
        put(&[length]);
        (0..length).for_each(|i| put(&i16::from(i).to_le_bytes()));
    }
    for (point, colour) in leaf().points.iter().zip(leaf().colours.unwrap()) {
        put(&point.x.to_le_bytes());
        put(&2u16.to_le_bytes());
        put(&7.0f32.to_le_bytes());
        put(&f32::NAN.to_le_bytes());
        put(&(point.y as f32).to_le_bytes());
        put(&[colour[0]]);
        put(&[253]);
        put(&(point.z as f32).to_le_bytes());
        put(&[colour[1]]);
        put(&[colour[2]]);
    }
    bytes
}

const TEXT_PLY: &str = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\n\
    property float y\nproperty float z\nproperty list uchar int seen_by\nproperty uchar red\n\
    property uchar green\nproperty uchar blue\nelement face 1\n\
    property list uchar int vertex_indices\nend_header\n\
    0.5 -0.25 1.5 2 7 8 255 0 51\n0 2 -8 0 1 2 3\n3 0 1 1\n";

fn pcd(data: &str, fields: &str, sizes: &str, types: &str, points: u64) -> Vec<u8> {
    format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\n\
         TYPE {types}\nWIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\n\
         DATA {data}\n"
    )
    .into_bytes()
}

/// The leaf as a text PCD; `colour` formats a packed colour.
fn text_pcd(letter: &str, colour: impl Fn(u32) -> String) -> Vec<u8> {
    let mut bytes = pcd("ascii", "x y z rgb", "4 4 4 4", &format!("F F F {letter}"), 2);
    for (point, [r, g, b]) in leaf().points.iter().zip(leaf().colours.unwrap()) {
        let packed = colour(u32::from_be_bytes([0, r, g, b]));
        bytes.extend(format!("{} {} {} {packed}\n", point.x, point.y, point.z).bytes());
    }
    bytes
}

#[test]
fn the_same_leaf_comes_out_of_every_ply() {
    for bytes in [crowded_ply(false), crowded_ply(true), TEXT_PLY.into()] {
        assert_eq!(reading(&bytes).unwrap(), CloudFile { cloud: leaf(), dropped: vec![] });
    }
}

#[test]
fn a_packed_colour_may_be_written_as_number_or_as_float_of_the_same_bits() {
    let integer = text_pcd("U", |bits| bits.to_string());
    let float_of_bits = text_pcd("F", |bits| f32::from_bits(bits).to_string());
    let float_of_number = text_pcd("F", |bits| format!("{:e}", bits as f32));
    let opaque = text_pcd("I", |bits| ((bits | 0xff00_0000) as i32).to_string());
    for bytes in [integer, float_of_bits, float_of_number, opaque] {
        assert_eq!(reading(&bytes).unwrap().cloud, leaf(), "{}", bytes.escape_ascii());
    }
    // In binary files, the highest byte may make the float of these bits NaN.
    let mut bytes = pcd("binary", "x y z rgba", "4 4 4 4", "F F F F", 1);
    bytes.extend([1.0f32, 2.0, 3.0].map(f32::to_le_bytes).concat());
    bytes.extend(0xff81_0203_u32.to_le_bytes());
    assert_eq!(reading(&bytes).unwrap().cloud.colours(), Some(&[[0x81, 2, 3]][..]));
}

#[test]
fn colours_are_bytes_whatever_they_were() {
    let with = |kind: &str, names: [&str; 3], colour: &str| {
        let [r, g, b] = names.map(|name| format!("property {kind} {name}\n"));
        let header = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n\
            property float y\nproperty float z\n";
        let text = format!("{header}{r}{g}{b}end_header\n0 0 0 {colour}\n");
        reading(text.as_bytes()).map(|reading| reading.cloud.colours().unwrap()[0])
    };
    let rgb = ["red", "green", "blue"];
    assert_eq!(with("uchar", ["r", "g", "b"], "255 128 1").unwrap(), [255, 128, 1]);
    assert_eq!(with("ushort", rgb, "65535 32896 257").unwrap(), [255, 128, 1]);
    let diffuse = ["diffuse_red", "diffuse_green", "diffuse_blue"];
    assert_eq!(with("float", diffuse, "1.0 0.5 0.0").unwrap(), [255, 128, 0]);
    assert_eq!(with("double", rgb, "255.0 127.6 0.0").unwrap(), [255, 128, 0]);
    for (kind, colour) in [("int", "256 0 0"), ("float", "-0.5 0 0"), ("float", "nan 0 0")] {
        let error = with(kind, rgb, colour).unwrap_err().to_string();
        assert!(error.contains("the finite point 0") && error.contains("wanted three"), "{error}");
    }
}

#[test]
fn points_without_coordinates_are_left_out_by_name() {
    // An organised cloud, 2 x 2, compressed: field after field, a histogram of three among them.
    let x = [f32::NAN, 1.0, f32::INFINITY, 2.0].map(f32::to_le_bytes).concat();
    let others = [5.0f32, 6.0, 7.0, 8.0].map(f32::to_le_bytes).concat();
    let body = [x, vec![9; 12], others.clone(), others, vec![0, 1, 2, 3]].concat();
    let packed: Vec<u8> =
        body.chunks(32).flat_map(|run| [&[run.len() as u8 - 1], run].concat()).collect();
    let mut bytes = b"VERSION .7\nFIELDS x h y z g\nSIZE 4 1 4 4 1\nTYPE F U F F U\n\
        COUNT 1 3 1 1 1\nWIDTH 2\nHEIGHT 2\nPOINTS 4\nDATA binary_compressed\n"
        .to_vec();
    bytes.extend((packed.len() as u32).to_le_bytes());
    bytes.extend((body.len() as u32).to_le_bytes());
    bytes.extend(packed);
    let CloudFile { cloud, dropped } = reading(&bytes).unwrap();
    assert_eq!(cloud.points(), [Point3::new(1.0, 6.0, 6.0), Point3::new(2.0, 8.0, 8.0)]);
    assert_eq!((cloud.colours(), dropped), (None, vec![0, 2]));
}

#[test]
fn a_cloud_in_millimetres_is_refused() {
    let message = failure(TEXT_PLY.replace("0.5", "1000.5").as_bytes());
    assert!(message.contains("1000.5") && message.contains("in millimetres"), "{message}");
}

#[test]
fn a_cloud_of_nothing_is_an_error() {
    let text = TEXT_PLY.replace("0.5", "nan").replace("-8", "-inf");
    assert!(failure(text.as_bytes()).contains("no finite point; 2 that"), "{}", text);
    let text = TEXT_PLY.replace("vertex 2", "vertex 0");
    assert!(failure(text.as_bytes()).contains("no finite point; 0 that"), "{}", text);
}

#[test]
fn a_header_that_promises_too_much_is_refused_without_being_allocated() {
    let promise = "1000000000000000";
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let text = TEXT_PLY.replace("ascii", format).replace("vertex 2", "vertex 1000000000000000");
        let error = failure(text.as_bytes());
        assert!(error.contains("truncated") || error.contains("`x`"), "{error}");
    }
    for data in ["ascii", "binary"] {
        let mut bytes = pcd(data, "x y z", "4 4 4", "F F F", promise.parse().unwrap());
        bytes.extend(*b"0 1 2 3 4 5 6 7 8 9 0 1 ");
        let error = failure(&bytes);
        assert!(error.contains(&format!("of the {promise} points")), "{error}");
    }
    let mut bytes = pcd("binary_compressed", "x y z", "4 4 4", "F F F", 1 << 28);
    bytes.extend([4u32, u32::MAX].map(u32::to_le_bytes).concat());
    bytes.extend([0; 4]);
    assert!(failure(&bytes).contains("cannot unpack to the promised 4294967295"));
    let wide = pcd("binary", "x y z", "4 4 4", "F F F", 1);
    let wide = String::from_utf8(wide).unwrap().replace("WIDTH", "COUNT 1 1 99999999999\nWIDTH");
    assert!(failure(wide.as_bytes()).contains("too many numbers"));
}

#[test]
fn a_truncated_file_says_how_much_it_holds() {
    let whole = crowded_ply(false);
    let error = failure(&whole[..whole.len() - 1]);
    assert!(error.contains("1 of the 2 rows of the element `vertex`"), "{error}");
    let cut = TEXT_PLY.split("1 2 3").next().unwrap();
    assert!(failure(cut.as_bytes()).contains("1 of the 2 rows"));
    let mut bytes = pcd("binary", "x y z", "4 4 4", "F F F", 2);
    bytes.extend([0; 23]);
    assert!(failure(&bytes).contains("1 of the 2 points"));
}

#[test]
fn a_file_that_is_not_a_cloud_is_reported() {
    assert!(failure(b"").contains("begins with nothing; wanted a PLY or PCD file"));
    assert!(failure(b"\x93NUMPY").contains("`\\x93NUMPY`"));
    let error = failure(TEXT_PLY.replace("float y", "float height").as_bytes());
    assert!(error.contains("found its properties `x`, `height`, `z`"), "{error}");
    let error = failure(TEXT_PLY.replace("vertex 2", "point 2").as_bytes());
    assert!(error.contains("found the elements `point`, `face`"), "{error}");
    let bytes = pcd("ascii", "x y intensity", "4 4 4", "F F F", 0);
    assert!(failure(&bytes).contains("found `x`, `y`, `intensity`"));
}

#[test]
fn the_error_names_the_line_where_a_header_is_wrong() {
    for (from, to, line, word) in [
        ("float y", "half y", 5, "`half` is not a type"),
        ("ascii", "utf8", 2, "format `utf8` is unknown"),
        ("vertex 2", "vertex -2", 3, "`-2` is not a number of"),
        ("element vertex 2\n", "", 3, "before the first `element`"),
        ("end_header\n", "", 13, "is not a keyword of PLY"),
    ] {
        let error = failure(TEXT_PLY.replace(from, to).as_bytes());
        assert!(error.contains(&format!("line {line}: ")) && error.contains(word), "{error}");
    }
    let plain = String::from_utf8(pcd("ascii", "x y z", "4 4 4", "F F F", 2)).unwrap();
    for (from, to, line, word) in [
        ("SIZE 4 4 4", "SIZE 4 4", 10, "3 FIELDS"),
        ("TYPE F F F", "TYPE F F B", 10, "TYPE B of SIZE 4"),
        ("POINTS 2", "POINTS 3", 10, "WIDTH times HEIGHT is 2"),
        ("DATA ascii", "DATA zip", 10, "binary_compressed"),
        ("DATA ascii\n", "", 10, "there is no line `DATA`"),
    ] {
        let error = failure(plain.replace(from, to).as_bytes());
        assert!(error.contains(&format!("line {line}: ")) && error.contains(word), "{error}");
    }
    let error = failure(TEXT_PLY.replace("1.5", "1,5").as_bytes());
    assert!(error.contains("`z` in line 14 is `1,5`; wanted a number"), "{error}");
}

#[test]
#[should_panic(expected = "wanted a single word")]
fn a_column_cannot_take_the_name_of_a_coordinate() {
    let _ = write_ply(Path::new("x"), &leaf(), &[("z", Column::U8(&[1, 2]))]);
}

#[test]
fn a_point_too_far_for_pcd_is_an_error_and_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("far.pcd");
    let far = Cloud::new(vec![Point3::new(0.0, 1e300, 0.0)], None);
    let error = write_pcd(&path, &far, &[]).unwrap_err().to_string();
    assert!(error.contains("point 0 is too far away") && !path.exists(), "{error}");
    assert!(!error.contains("try another place"), "the place is not to blame: {error}");
}

/// Clouds of up to a dozen points within a kilometre, with or without colours.
fn clouds() -> impl Strategy<Value = Cloud> {
    let point = prop::array::uniform3(prop::num::f32::NORMAL | prop::num::f32::ZERO);
    let rows = prop::collection::vec((point, any::<[u8; 3]>()), 1..12);
    (rows, any::<bool>()).prop_map(|(rows, coloured)| {
        let (points, colours): (Vec<_>, Vec<_>) = rows.into_iter().unzip();
        let points =
            points.into_iter().map(|p| Point3::from(p.map(|x| f64::from(x % 1000.0)))).collect();
        Cloud::new(points, coloured.then_some(colours))
    })
}

proptest! {
    #[test]
    fn what_is_written_reads_back_to_the_last_bit(single in clouds(), stretch in 0.1f64..1.0) {
        let folder = tempfile::tempdir().unwrap();
        let (ply, pcd) = (folder.path().join("a"), folder.path().join("b"));
        let stiffness: Vec<f64> = (0..single.len()).map(|row| row as f64 / 3.0).collect();
        let narrow: Vec<f32> = stiffness.iter().map(|&k| k as f32).collect();
        let touched = vec![1; single.len()];
        let columns = [
            ("K", Column::F64(&stiffness)),
            ("K_std", Column::F32(&narrow)),
            ("touched", Column::U8(&touched)),
        ];
        write_pcd(&pcd, &single, &columns).unwrap();
        prop_assert_eq!(read(&pcd).unwrap().cloud, single.clone());

        let points = single.points.iter().map(|point| point * stretch).collect();
        let double = Cloud::new(points, single.colours);
        write_ply(&ply, &double, &columns).unwrap();
        prop_assert_eq!(read(&ply).unwrap().cloud, double);
    }
}
