//! Fields as npz files: files of numpy, of OpenVSF and of palpate, and errors for defects.
#![allow(missing_docs, clippy::unwrap_used)]

use palpate_io::field::npz::{Array, Arrays, Data, NpzError, read_npz, write_npz};
use palpate_io::field::{FieldFile, FieldLattice};
use proptest::prelude::*;
use std::fs;
use std::path::{Path, PathBuf};

fn testdata(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata").join(name)
}

/// The field in `testdata/npz.py`.
fn field() -> FieldFile {
    let [origin_m, shape] = [[-1.2, -1.2, 0.0], [200.0, 200.0, 100.0]];
    FieldFile {
        points: vec![[0.0, 0.1, 0.2], [1.0, 1.1, 1.2], [-1.0, 0.5, 0.25]],
        stiffness: vec![10.0, 0.0, 250.5],
        std: Some(vec![1.0, 2.0, 3.0]),
        counts: Some(vec![4, 5, 6]),
        prior: None,
        lattice: Some(FieldLattice { origin_m, spacing_m: 0.012, shape: shape.map(|n| n as u32) }),
        cells: Some(vec![7, 8, 39999]),
    }
}

const SETTINGS: &str = r#"{"spacing_m": 0.012, "name": "süß"}"#;

fn arrays() -> Arrays {
    let mut arrays = field().to_arrays();
    arrays.insert("settings", Array::text(SETTINGS));
    arrays
}

fn entries(arrays: &Arrays) -> Vec<(String, Array)> {
    arrays.iter().map(|(name, array)| (name.to_owned(), array.clone())).collect()
}

#[test]
fn what_numpy_writes_is_read() {
    let arrays = read_npz(&testdata("numpy.npz")).unwrap();
    assert_eq!(FieldFile::from_arrays(&arrays).unwrap(), field());
    let cube = Array::new(vec![2, 3, 4], Data::I64((0..24).collect()));
    assert_eq!(arrays.get("cube"), Some(&cube), "Fortran order in three dimensions");
    assert_eq!(arrays.floats("scalar", &[]).unwrap(), [2.5]);
}

#[test]
fn what_openvsf_writes_is_read_without_pickle() {
    let arrays = read_npz(&testdata("openvsf.npz")).unwrap();
    let field = FieldFile::from_arrays(&arrays).unwrap();
    assert_eq!(field.stiffness, [10.0, 0.0, 250.5]);
    assert_eq!((field.std, field.lattice, field.cells), (None, None, None));
    let skipped: Vec<_> = arrays.skipped().iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(skipped, ["axis_mode", "features"]);
    let error = arrays.require("features").unwrap_err().to_string();
    assert!(error.contains("pickle"), "{error}");
}

/// That numpy reads this golden file is checked by hand: `testdata/npz.py check`.
#[test]
fn what_we_write_reads_back_and_the_golden_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("field.npz");
    write_npz(&path, &arrays()).unwrap();
    if std::env::var_os("PALPATE_UPDATE_GOLDEN").is_some() {
        fs::copy(&path, testdata("palpate.npz")).unwrap();
    }
    for path in [path, testdata("palpate.npz")] {
        let read = read_npz(&path).unwrap();
        assert_eq!(entries(&read), entries(&arrays()));
        assert_eq!(FieldFile::from_arrays(&read).unwrap(), field());
        assert_eq!(read.text("settings").unwrap(), SETTINGS);
    }
}

#[test]
fn the_same_arrays_give_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = ["a.npz", "b.npz"].map(|name| {
        let path = folder.path().join(name);
        write_npz(&path, &arrays()).unwrap();
        fs::read(path).unwrap()
    });
    assert_eq!(bytes[0], bytes[1]);
}

#[test]
fn every_defect_of_a_field_is_named() {
    let nan = |n: usize| Array::flat(Data::F64(vec![f64::NAN; n]));
    let f64s = |numbers: &[f64]| Array::flat(Data::F64(numbers.to_vec()));
    let u32s = |numbers: &[u32]| Array::flat(Data::U32(numbers.to_vec()));
    let cases = [
        ("points", f64s(&[1.0; 9]), "floats of shape [N, 3]"),
        (
            "points",
            Array::new(vec![3, 3], Data::I64(vec![0; 9])),
            "i8 of shape [3, 3]; wanted floats",
        ),
        ("K", nan(3), "NaN in row 0"),
        ("K", f64s(&[1.0, 2.0]), "f8 of shape [2]; wanted floats of shape [3]"),
        ("K", f64s(&[1.0, -2.0, 3.0]), "-2 in row 1"),
        ("K", Array::new(vec![3, 3], Data::F64(vec![1.0; 9])), "wanted floats of shape [3]"),
        ("K_std", f64s(&[1.0, f64::INFINITY, 3.0]), "inf in row 1"),
        ("K_prior", f64s(&[1.0, 2.0]), "f8 of shape [2]; wanted floats of shape [3]"),
        ("K_prior", f64s(&[1.0, 2.0, -0.5]), "-0.5 in row 2"),
        ("K_prior", nan(3), "NaN in row 0"),
        ("N_obs", Array::flat(Data::I64(vec![1, 2, -3])), "-3 in row 2"),
        ("N_obs", Array::flat(Data::U64(vec![1, 2, 1 << 40])), "row 2"),
        ("lattice", f64s(&[0.0; 6]), "floats of shape [7]"),
        ("lattice", f64s(&[0.0, 0.0, 0.0, 0.0, 9.0, 9.0, 9.0]), "a spacing above 0"),
        ("lattice", f64s(&[0.0, 0.0, 0.0, 1.0, 9.0, 9.5, 9.0]), "9.5 in row 5"),
        ("cells", u32s(&[1, 2, 4_000_000]), "4000000 in row 2"),
        ("cells", u32s(&[1, 2, 1]), "each cell once"),
        ("cells", u32s(&[1, 2]), "wanted integers of shape [3]"),
    ];
    for (name, array, wanted) in cases {
        let mut broken = arrays();
        broken.insert(name, array);
        let error = FieldFile::from_arrays(&broken).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(wanted), "{name}: {error}");
    }
    let mut empty = Arrays::new();
    empty.insert("other", f64s(&[1.0]));
    let error = FieldFile::from_arrays(&empty).unwrap_err().to_string();
    assert!(error.contains("no array `points`: it holds other"), "{error}");
}

#[test]
fn a_truncated_or_flipped_file_is_an_error_not_other_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, broken) = (folder.path().join("whole.npz"), folder.path().join("broken.npz"));
    write_npz(&whole, &arrays()).unwrap();
    let bytes = fs::read(&whole).unwrap();
    for length in (0..bytes.len()).step_by(7) {
        fs::write(&broken, &bytes[..length]).unwrap();
        assert!(read_npz(&broken).is_err(), "{length} of {} bytes", bytes.len());
    }
    for at in 0..bytes.len() {
        let mut flipped = bytes.clone();
        flipped[at] ^= 0x10;
        fs::write(&broken, flipped).unwrap();
        // A flip may hit a name, or bytes without meaning (a date): the numbers are then unchanged.
        if let Ok(read) = read_npz(&broken) {
            for (name, array) in read.iter() {
                let known = arrays().get(name).cloned();
                assert!(known.is_none_or(|known| known == *array), "byte {at} changed `{name}`");
            }
        }
    }
}

#[test]
fn a_file_that_is_not_npz_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("field.npz");
    assert!(matches!(read_npz(&path), Err(NpzError::Io { .. })));
    for bytes in [&b""[..], b"PK\x05\x06", b"solid cube"] {
        fs::write(&path, bytes).unwrap();
        assert!(matches!(read_npz(&path), Err(NpzError::NotNpz { .. })), "{bytes:?}");
    }
    assert!(read_npz(folder.path()).is_err());
}

#[test]
fn a_claimed_size_is_not_allocated() {
    let folder = tempfile::tempdir().unwrap();
    for (shape, wanted) in [("(100000000,)", "truncated"), ("(9999999999999,)", "more than")] {
        let path = folder.path().join("bomb.npz");
        let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}");
        let mut npy = b"\x93NUMPY\x01\x00".to_vec();
        npy.extend((header.len() as u16).to_le_bytes());
        npy.extend(header.as_bytes());
        let mut zip = zip::ZipWriter::new(fs::File::create(&path).unwrap());
        zip.start_file("K.npy", zip::write::SimpleFileOptions::default()).unwrap();
        std::io::Write::write_all(&mut zip, &npy).unwrap();
        zip.finish().unwrap();
        let error = read_npz(&path).unwrap_err().to_string();
        assert!(error.contains(wanted), "{error}");
    }
}

proptest! {
    #[test]
    fn arrays_come_back_as_they_were(
        floats in prop::collection::vec(any::<f64>(), 0..50),
        bytes in prop::collection::vec(any::<u8>(), 0..50),
        sides in (0usize..4, 0usize..4, 1usize..4),
    ) {
        let mut arrays = Arrays::new();
        let size = sides.0 * sides.1 * sides.2;
        arrays.insert("box", Array::new(vec![sides.0, sides.1, sides.2], Data::U32(vec![7; size])));
        arrays.insert("bytes", Array::flat(Data::U8(bytes)));
        let bits: Vec<u64> = floats.iter().map(|x| x.to_bits()).collect();
        arrays.insert("floats", Array::flat(Data::F64(floats)));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("any.npz");
        write_npz(&path, &arrays).unwrap();
        let read = read_npz(&path).unwrap();
        prop_assert_eq!(read.get("box"), arrays.get("box"));
        prop_assert_eq!(read.get("bytes"), arrays.get("bytes"));
        let Some(Data::F64(floats)) = read.get("floats").map(Array::data) else { panic!() };
        prop_assert_eq!(floats.iter().map(|x| x.to_bits()).collect::<Vec<_>>(), bits);
    }
}
