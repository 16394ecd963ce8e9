//! Seeds of the targets: files that palpate itself writes, and small files of other programs.

use std::collections::BTreeMap;
use std::io::{self, Cursor};
use std::path::Path;
use std::sync::{Arc, OnceLock};

use nalgebra::Point3;
use palpate::{Arm, BakeConfig, EstimatorKind, Lattice, Mapper, MapperConfig, Robot, Sample};
use palpate_io::cloud::{self, Cloud, Column};
use palpate_io::field::{SavedField, npz, to_bytes};
use palpate_io::log::bag_write::{BagWriter, Compression};
use palpate_io::log::write::{TableWriter, TouchWriter};
use palpate_work::settings::Settings;

use crate::scratch;

/// An arm of two joints.
pub(crate) const URDF: &str = r#"<robot name="two"><link name="base"/>
<joint name="a" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="20" velocity="2"/></joint>
<link name="l1"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
</inertial><collision><origin xyz="0.2 0 0" rpy="0 0.1 0"/><geometry><box size="0.3 0.1 0.1"/></geometry>
</collision></link>
<joint name="b" type="prismatic"><origin xyz="0.4 0 0"/><parent link="l1"/><child link="l2"/>
<axis xyz="0 1 0"/><limit lower="0" upper="0.2" effort="20" velocity="2"/></joint>
<link name="l2"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
</robot>"#;

/// A touch of this arm: it rests, then moves.
fn samples() -> impl Iterator<Item = Sample> {
    (0..20_u8).map(|frame| {
        let at = 0.02 * f64::from(frame.saturating_sub(8));
        Sample::new(Some(0.1 * f64::from(frame)), vec![at, 0.1], vec![-at, 0.2])
    })
}

fn joints() -> Vec<String> {
    ["a", "b"].map(str::to_owned).to_vec()
}

/// A mapper that has learnt this touch.
fn mapper() -> &'static Mapper {
    static MAPPER: OnceLock<Mapper> = OnceLock::new();
    MAPPER.get_or_init(|| {
        let robot = Robot::from_urdf(URDF).expect("it is a robot");
        let bake = BakeConfig::new(0.02, 0.06);
        let (arm, _) = Arm::bake(robot, &bake, |_| unreachable!("no meshes")).expect("it is baked");
        let mut config = MapperConfig::of(EstimatorKind::Map);
        config.lattice =
            Lattice::filling([-0.1, -0.2, -0.2], [0.6, 0.4, 0.2], 0.05).expect("a box");
        let mut mapper = Mapper::new(Arc::new(arm), config).expect("a mapper");
        mapper.begin_touch();
        samples().for_each(|sample| drop(mapper.step(&sample)));
        let _ = mapper.end_touch();
        mapper
    })
}

/// The field file of this mapper.
fn field() -> Vec<u8> {
    to_bytes(&SavedField::of_mapper(mapper()))
}

/// Field files of palpate, numpy and OpenVSF.
pub(crate) fn fields() -> Vec<Vec<u8>> {
    let [numpy, openvsf] = [
        &include_bytes!("../../palpate-io/testdata/numpy.npz")[..],
        include_bytes!("../../palpate-io/testdata/openvsf.npz"),
    ];
    vec![field(), numpy.to_vec(), openvsf.to_vec()]
}

/// The arrays of the field file.
pub(crate) fn arrays_of_field() -> &'static npz::Arrays {
    static ARRAYS: OnceLock<npz::Arrays> = OnceLock::new();
    let read = || npz::read_npz_bytes(&field(), "seed").expect("it was just written");
    ARRAYS.get_or_init(read)
}

/// A change of each array, as input of the target `npz_member`: the index of the array, then the change.
pub(crate) fn members() -> Vec<Vec<u8>> {
    let arrays = arrays_of_field();
    let change = |(place, (_, array)): (u8, (&str, &npz::Array))| match array.data() {
        npz::Data::U8(text) => [&[place][..], text].concat(),
        _ => [&[place, 1, 0, 0][..], &0.5_f64.to_le_bytes()].concat(),
    };
    (0..).zip(arrays.iter()).map(change).collect()
}

/// An npy file of floats.
fn npy(shape: (usize, usize), numbers: impl IntoIterator<Item = f64>) -> Vec<u8> {
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape:?}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(u16::try_from(header.len()).expect("a short header").to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(numbers.into_iter().flat_map(f64::to_le_bytes));
    bytes
}

/// The two npy files of a touch, as input of the target `npy_folder`: the length of the first, then both.
pub(crate) fn arrays() -> Vec<Vec<u8>> {
    let q = npy((20, 2), samples().flat_map(|sample| sample.q));
    let tau = npy((20, 2), samples().flat_map(|sample| sample.tau));
    let length = u16::try_from(q.len()).expect("a short array").to_le_bytes();
    vec![[&length[..], &q, &tau].concat()]
}

fn write_one_touch(mut writer: impl TouchWriter) -> io::Result<()> {
    writer.touch("one")?;
    samples().try_for_each(|sample| writer.sample(&sample))?;
    writer.finish()
}

/// Tables: one of palpate, and others with other delimiters and names.
pub(crate) fn table() -> Vec<Vec<u8>> {
    let mut text = Vec::new();
    write_one_touch(TableWriter::new(&mut text, Some(joints()))).expect("memory takes it");
    let others = [
        "t;q1;q2;tau1;tau2\n0;0,5;1;2;3\n1;0,6;1;2;3\n",
        "# é\r\n\"/joint_states/position[0]\",/joint_states/position[1],joint_1_effort,joint_2_effort,seq\r\n\
         0,1,-2e-3,.5,0\r\n# c\r\n\r\n1,1,\"3\",.5,1\r\n",
        "pos 1\tq_[02]\ttau(1)\ttau_2\ttime\n0\t1\tnan\t-inf\té\n",
    ];
    others.map(|other| other.as_bytes().to_vec()).into_iter().chain([text]).collect()
}

/// A bag with each compression of its chunks.
pub(crate) fn bag() -> Vec<Vec<u8>> {
    [Compression::Zstd, Compression::Lz4, Compression::None].map(bag_of).to_vec()
}

fn bag_of(compression: Compression) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let written = BagWriter::new(&mut bytes, joints(), compression).and_then(write_one_touch);
    written.expect("memory takes it");
    bytes.into_inner()
}

/// A bag with ten messages of joint states, each of which has these bytes.
pub(crate) fn bag_of_message(bytes: &[u8]) -> Vec<u8> {
    let written = || -> mcap::McapResult<Vec<u8>> {
        let mut bag = Cursor::new(Vec::new());
        let options = mcap::WriteOptions::new().compression(None).profile("ros2");
        let mut writer = options.create(&mut bag)?;
        let schema = writer.add_schema("sensor_msgs/msg/JointState", "ros2msg", b"")?;
        let channel = writer.add_channel(schema, "/joint_states", "cdr", &BTreeMap::new())?;
        for sequence in 0..10 {
            let time = u64::from(sequence);
            let header = mcap::records::MessageHeader {
                channel_id: channel,
                sequence,
                log_time: time,
                publish_time: time,
            };
            writer.write_to_known_channel(&header, bytes)?;
        }
        writer.finish()?;
        drop(writer);
        Ok(bag.into_inner())
    };
    written().expect("memory takes it")
}

/// A joint state as CDR.
pub(crate) fn message() -> Vec<Vec<u8>> {
    let mut cdr = vec![0, 1, 0, 0];
    let put = |cdr: &mut Vec<u8>, bytes: &[u8]| {
        let size = if bytes.len() == 8 { 8 } else { 4 };
        while !(cdr.len() - 4).is_multiple_of(size) {
            cdr.push(0);
        }
        cdr.extend(bytes);
    };
    let text = |cdr: &mut Vec<u8>, text: &str| {
        put(cdr, &u32::try_from(text.len() + 1).expect("short").to_le_bytes());
        cdr.extend(text.as_bytes());
        cdr.push(0);
    };
    cdr.extend([1, 0, 0, 0, 2, 0, 0, 0]);
    text(&mut cdr, "base");
    put(&mut cdr, &2_u32.to_le_bytes());
    text(&mut cdr, "a");
    text(&mut cdr, "b");
    for numbers in [&[0.1, 0.2][..], &[], &[1.0, 2.0]] {
        put(&mut cdr, &u32::try_from(numbers.len()).expect("short").to_le_bytes());
        numbers.iter().for_each(|number: &f64| put(&mut cdr, &number.to_le_bytes()));
    }
    vec![cdr]
}

/// A database as rosbag2 writes it.
pub(crate) fn database() -> Vec<Vec<u8>> {
    let bytes = scratch::written("seed.db3", |path| {
        let database = rusqlite::Connection::open(path).expect("a database");
        let tables = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, \
            type TEXT NOT NULL, serialization_format TEXT NOT NULL, \
            offered_qos_profiles TEXT NOT NULL); \
            CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, \
            timestamp INTEGER NOT NULL, data BLOB NOT NULL); \
            INSERT INTO topics VALUES(1, '/joint_states', 'sensor_msgs/msg/JointState', 'cdr', '');";
        database.execute_batch(tables).expect("tables");
        for at in 0..5_i64 {
            let insert = "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)";
            database.execute(insert, (at, &message()[0])).expect("a row");
        }
    });
    vec![bytes]
}

/// A table of columns as Parquet.
pub(crate) fn parquet() -> Vec<Vec<u8>> {
    use parquet::data_type::DoubleType;
    use parquet::file::properties::WriterProperties;
    use parquet::file::writer::SerializedFileWriter;
    use parquet::schema::parser::parse_message_type;
    let schema = "message s { required double q1; required double q2; required double tau1; \
                  required double tau2; required double time; }";
    let schema = Arc::new(parse_message_type(schema).expect("a schema"));
    let mut bytes = Vec::new();
    let properties = Arc::new(WriterProperties::builder().build());
    let mut writer = SerializedFileWriter::new(&mut bytes, schema, properties).expect("a writer");
    let mut rows = writer.next_row_group().expect("rows");
    while let Some(mut column) = rows.next_column().expect("a column") {
        let numbers = [0.1, 0.2, 0.3, 0.4];
        column.typed::<DoubleType>().write_batch(&numbers, None, None).expect("memory takes it");
        column.close().expect("memory takes it");
    }
    rows.close().expect("memory takes it");
    writer.close().expect("memory takes it");
    vec![bytes]
}

/// A URDF, and one with a mimic joint.
pub(crate) fn robot() -> Vec<Vec<u8>> {
    let mimic = URDF.replace(
        "</robot>",
        "<link name=\"l3\"/><joint name=\"c\" type=\"revolute\">\
        <parent link=\"l2\"/><child link=\"l3\"/><mimic joint=\"a\" multiplier=\"-1\"/>\
        <limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint></robot>",
    );
    vec![URDF.into(), mimic.into_bytes()]
}

/// Meshes in every format, each after the number of its format; they are small, so that baking is fast.
pub(crate) fn mesh() -> Vec<Vec<u8>> {
    let corners = [[0.0_f32, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]];
    let faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
    let mut stl = vec![0; 81];
    stl.extend(4_u32.to_le_bytes());
    for face in faces {
        stl.extend([0; 12]);
        stl.extend(face.iter().flat_map(|&at: &usize| corners[at]).flat_map(f32::to_le_bytes));
        stl.extend([0, 0]);
    }
    let obj = b"\x01v 0 0 0\nv .1 0 0\nv 0 .1 0 # a corner\nv 0 0 1e-1\nvt 0 0\nvn 0 0 1\nusemtl tin\nf 1/1/1 3/1/1 2/1/1\n\
        f 1//1 2//1 4//1\nf -4 -1 -2\nf 2 3 4\n";
    let text = b"\0solid a\nfacet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex .1 0 0\nvertex 0 .1 0\nendloop\nendfacet\n\
        endsolid a\n";
    let dae = include_str!("../../palpate-io/testdata/boxes.dae")
        .replace("0.001", "0.0001")
        .replace("10000", "300");
    vec![stl, obj.to_vec(), text.to_vec(), [&[2], dae.as_bytes()].concat()]
}

/// Clouds as PLY and PCD: binary, compressed and text.
pub(crate) fn cloud() -> Vec<Vec<u8>> {
    let leaf = Cloud::new(vec![Point3::new(0.5, 0.0, 0.3); 3], Some(vec![[30, 120, 40]; 3]));
    let columns = [("K", Column::F64(&[85.0; 3])), ("touched", Column::U8(&[1; 3]))];
    let as_file = |name: &str, write: &dyn Fn(&Path)| scratch::written(name, write);
    let ply = as_file("seed.ply", &|path| {
        cloud::write_ply(path, &leaf, &columns).expect("room for a file");
    });
    let pcd = as_file("seed.pcd", &|path| {
        cloud::write_pcd(path, &leaf, &columns).expect("room for a file");
    });
    let ascii = b"ply\nformat ascii 1.0\ncomment x\nelement vertex 2\nproperty float x\nproperty short y\n\
        property double z\nproperty list int int l\nelement face 1\nproperty list char uint f\nend_header\n\
        0 0 0 2 5 6\n1 1 1 0\n3 0 1 0\n";
    let text = b"VERSION 0.7\nFIELDS x y z rgb\nSIZE 4 2 8 4\nTYPE F I F U\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\n\
        POINTS 2\nDATA ascii\n0.5 1 nan 65280\n-1 -2 3e-1 0\n";
    let open3d = include_bytes!("../../palpate-io/testdata/open3d/compressed.pcd");
    let packed =
        b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n\
        POINTS 1\nDATA binary_compressed\n\x0e\0\0\0\x0c\0\0\0\x0b\0\0\0\0\0\0\0\0\0\0\0\0";
    vec![ply, pcd, ascii.to_vec(), text.to_vec(), open3d.to_vec(), packed.to_vec()]
}

/// Files of cameras and of poses.
pub(crate) fn camera() -> Vec<Vec<u8>> {
    let texts = [
        r#"{"fx": 100, "fy": 100, "cx": 32, "cy": 24, "width": 64, "height": 48,
            "camera_to_world": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"#,
        "image_width: 64\nimage_height: 48\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [100, 0, 32, \
         0, 100, 24, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  \
         cols: 5\n  data: [0.1, 0, 0, 0, 0]\n",
        "header:\n  stamp: {}\nheight: 48\nwidth: 64\ndistortion_model: rational_polynomial\nd:\n- 0.5\n- -2.6\n\
         - 0\n- 0\n- 1.5\n- 0.4\n- -2.4\n- 1.4\nk:\n- 100.0\n- 0\n- 32\n- 0\n- 100\n- 24\n- 0\n- 0\n- 1\n---\n",
        include_str!("../../palpate-io/testdata/open3d/parameters.json"),
        "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n",
        "0.5 0.25 1.5  -0.5 0.5 -0.5 0.5",
    ];
    let pose = npy((4, 4), (0..16).map(|place| f64::from(place % 5 == 0)));
    texts.map(|text| text.as_bytes().to_vec()).into_iter().chain([pose]).collect()
}

/// Colour and depth images.
pub(crate) fn picture() -> Vec<Vec<u8>> {
    let png_of = |colour: png::ColorType, depth: png::BitDepth, bytes: usize| {
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, 4, 4);
        encoder.set_color(colour);
        encoder.set_depth(depth);
        let mut writer = encoder.write_header().expect("memory takes it");
        writer.write_image_data(&vec![7; 16 * bytes]).expect("memory takes it");
        writer.finish().expect("memory takes it");
        out
    };
    let tiff = [
        &b"II*\0\x18\0\0\0"[..],
        &[1; 16],
        b"\x08\0",
        b"\0\x01\x03\0\x01\0\0\0\x02\0\0\0",
        b"\x01\x01\x03\0\x01\0\0\0\x02\0\0\0",
        b"\x02\x01\x03\0\x01\0\0\0\x20\0\0\0",
        b"\x06\x01\x03\0\x01\0\0\0\x01\0\0\0",
        b"\x11\x01\x04\0\x01\0\0\0\x08\0\0\0",
        b"\x16\x01\x03\0\x01\0\0\0\x02\0\0\0",
        b"\x17\x01\x04\0\x01\0\0\0\x10\0\0\0",
        b"\x53\x01\x03\0\x01\0\0\0\x03\0\0\0",
        &[0; 4],
    ]
    .concat();
    vec![
        png_of(png::ColorType::Rgb, png::BitDepth::Eight, 3),
        png_of(png::ColorType::Grayscale, png::BitDepth::Sixteen, 2),
        include_bytes!("../../palpate-io/testdata/open3d/halves.jpg").to_vec(),
        tiff,
        npy((2, 2), [0.5; 4]),
    ]
}

/// Settings: all with their defaults, and a map of columns.
pub(crate) fn settings() -> Vec<Vec<u8>> {
    let text = Settings::default().template().expect("the defaults hold");
    vec![text.into_bytes(), b"[log]\ncolumns = { q = [\"a\"], tau = [\"b\"] }\n".to_vec()]
}

/// Lines of the socket protocol.
pub(crate) fn question() -> Vec<Vec<u8>> {
    [
        r#"{"path": [[0.1, 0.2], [0.1, 0.3]], "exact": true}"#,
        r#"{"path_f64": "AAAAAAAA8D8AAAAAAADwPwAAAAAAAPA/AAAAAAAA8D8="}"#,
        r#"{"tare": true}"#,
    ]
    .map(|line| line.as_bytes().to_vec())
    .to_vec()
}
