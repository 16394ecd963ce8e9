//! Robots from files: search for meshes, baking, and the cache.
#![allow(missing_docs, clippy::unwrap_used)]

use palpate_io::robot_files::{ArmOptions, CachePlace, LoadedArm, load_arm};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A folder with a robot of one joint: the arm is a mesh of 20 x 10 x 30 cm, the base a sphere.
struct Bench {
    root: TempDir,
    options: ArmOptions,
}

impl Bench {
    fn new(mesh: &str) -> Self {
        let root = tempfile::tempdir().unwrap();
        let options = ArmOptions {
            cache: CachePlace::At(root.path().join("cache")),
            ..ArmOptions::default()
        };
        let bench = Self { root, options };
        bench.write("robot.urdf", &urdf(mesh));
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.root.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).unwrap();
    }

    /// Copies the box of the test data.
    fn put_mesh(&self, name: &str) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/box.stl");
        fs::copy(source, path).unwrap();
    }

    fn load(&self) -> Result<LoadedArm, String> {
        let path = self.path("robot.urdf").display().to_string();
        load_arm(&path, &self.options).map_err(|error| error.to_string())
    }

    /// Whether each link came from the cache.
    fn cached(&self) -> Vec<bool> {
        self.load().unwrap().links.iter().map(|link| link.cached).collect()
    }

    fn cache_files(&self) -> Vec<PathBuf> {
        let entries = fs::read_dir(self.path("cache")).unwrap();
        let mut files: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
        files.sort();
        files
    }
}

fn urdf(mesh: &str) -> String {
    format!(
        r#"<robot name="one">
  <link name="base"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
  <link name="arm">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><mesh filename="{mesh}" scale="0.1 0.1 0.1"/></geometry></collision>
  </link>
  <link name="tip"/>
  <joint name="j" type="revolute">
    <parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
  <joint name="f" type="fixed"><parent link="arm"/><child link="tip"/></joint>
</robot>"#
    )
}

#[test]
fn a_mesh_becomes_a_surface_and_comes_from_the_cache_the_next_time() {
    let bench = Bench::new("box.stl");
    bench.put_mesh("box.stl");
    let first = bench.load().unwrap();
    let names: Vec<_> = first.links.iter().map(|link| link.name.as_str()).collect();
    assert_eq!(names, ["base", "arm"], "a link without shapes has no surface");
    assert_eq!(first.links[1].meshes, [bench.path("./box.stl")]);
    assert!((first.links[1].report.inside_m3 / 0.006 - 1.0).abs() < 0.1);
    let grid = |loaded: &LoadedArm| loaded.arm.surfaces[1].clone().unwrap();
    let middle = nalgebra::Point3::new(0.1, 0.05, 0.15);
    assert!((grid(&first).distance(&middle) + 0.05).abs() < 0.006);

    let second = bench.load().unwrap();
    assert!(second.links.iter().all(|link| link.cached) && second.warnings.is_empty());
    assert_eq!(second.links[1].report, first.links[1].report);
    assert_eq!(grid(&second).to_bytes(), grid(&first).to_bytes());
}

#[test]
fn a_broken_cut_or_renamed_cache_file_is_baked_again() {
    let bench = Bench::new("box.stl");
    bench.put_mesh("box.stl");
    bench.load().unwrap();
    let files = bench.cache_files();
    let whole: Vec<Vec<u8>> = files.iter().map(|file| fs::read(file).unwrap()).collect();
    for damage in ["flip", "cut", "empty", "swap"] {
        for (file, bytes) in files.iter().zip(&whole) {
            let mut bytes = bytes.clone();
            match damage {
                "flip" => bytes[100] ^= 1,
                "cut" => bytes.truncate(bytes.len() - 1),
                "empty" => bytes.clear(),
                _ => bytes.clone_from(&whole[usize::from(*file == files[0])]),
            }
            fs::write(file, bytes).unwrap();
        }
        assert_eq!(bench.cached(), [false, false], "{damage}");
        assert_eq!(bench.cached(), [true, true], "{damage}: it was not repaired");
    }
}

#[test]
fn whatever_changes_the_shape_changes_the_key() {
    let mut bench = Bench::new("box.stl");
    bench.put_mesh("box.stl");
    bench.load().unwrap();
    bench.write("robot.urdf", &urdf("box.stl").replace("0.1 0.1 0.1", "0.1 0.1 0.2"));
    assert_eq!(bench.cached(), [true, false], "scale");
    bench.write("robot.urdf", &urdf("box.stl").replace("0.05", "0.06"));
    assert_eq!(bench.cached(), [false, true], "radius");
    let mut bytes = fs::read(bench.path("box.stl")).unwrap();
    let last = bytes.len() - 12;
    bytes[last] ^= 1;
    fs::write(bench.path("box.stl"), bytes).unwrap();
    assert_eq!(bench.cached(), [true, false], "bytes of the mesh");
    bench.options.bake.spacing_m = 0.006;
    assert_eq!(bench.cached(), [false, false], "spacing");
}

#[test]
fn without_a_usable_cache_the_robot_loads_all_the_same() {
    let mut bench = Bench::new("box.stl");
    bench.put_mesh("box.stl");
    bench.options.cache = CachePlace::Off;
    assert!(bench.load().unwrap().warnings.is_empty());
    bench.write("file", "");
    bench.options.cache = CachePlace::At(bench.path("file/cache"));
    let loaded = bench.load().unwrap();
    assert_eq!(loaded.warnings.len(), 1, "{:?}", loaded.warnings);
    assert!(loaded.warnings[0].contains("could not be stored"));
}

#[cfg(unix)]
#[test]
fn a_cache_that_others_may_write_to_is_not_used_and_a_warning_says_so() {
    use std::os::unix::fs::PermissionsExt;
    let bench = Bench::new("box.stl");
    bench.put_mesh("box.stl");
    assert_eq!((bench.cached(), bench.cached()), (vec![false, false], vec![true, true]));
    let folder = bench.cache_files()[0].parent().unwrap().to_owned();
    let mode = || folder.metadata().unwrap().permissions().mode() & 0o777;
    assert_eq!(mode(), 0o700);
    for (others, used) in [(0o770, false), (0o757, false), (0o755, true)] {
        fs::set_permissions(&folder, fs::Permissions::from_mode(others)).unwrap();
        let loaded = bench.load().unwrap();
        assert!(loaded.links.iter().all(|link| link.cached == used), "{others:o}");
        let warned = loaded.warnings.iter().any(|warning| warning.contains("chmod go-w"));
        assert_eq!(warned, !used, "{others:o}: {:?}", loaded.warnings);
    }
}

#[test]
fn several_processes_may_bake_at_once() {
    let bench = Bench::new("box.stl");
    bench.put_mesh("box.stl");
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| assert!(bench.load().unwrap().warnings.is_empty()));
        }
    });
    assert_eq!(bench.cached(), [true, true]);
    assert_eq!(bench.cache_files().len(), 2, "nothing half-written is left");
}

#[test]
fn a_package_is_looked_for_in_the_given_folders_and_above_the_urdf() {
    let mut bench = Bench::new("package://my_arm/meshes/box.stl");
    let error = bench.load().unwrap_err();
    assert!(error.contains("link `arm`") && error.contains("package://my_arm"), "{error}");
    assert!(error.contains("my_arm/meshes/box.stl`, "), "where it looked: {error}");
    bench.put_mesh("elsewhere/my_arm/meshes/box.stl");
    assert!(bench.load().is_err());
    bench.options.package_path = vec![bench.path("elsewhere")];
    assert!(bench.load().is_ok());
}

#[test]
fn every_defect_is_named() {
    let bench = Bench::new("box.stl");
    let error = bench.load().unwrap_err();
    assert!(error.contains("needs the mesh `box.stl`, which was not found"), "{error}");
    bench.write("box.stl", "nonsense");
    let error = bench.load().unwrap_err();
    assert!(error.contains("link `arm`: the mesh") && error.contains("box.stl"), "{error}");
    for (text, wanted) in [
        ("<robot", "robot.urdf"),
        ("<robot><xacro:include/></robot>", "expand it first"),
        (&urdf("https://example.org/box.stl"), "copy it to a file beside the URDF"),
        (&urdf("box.ply"), "box.ply"),
        (&urdf("box.stl").replace("value=\"1\"", "value=\"-1\""), "-1"),
    ] {
        bench.write("robot.urdf", text);
        let error = bench.load().unwrap_err();
        assert!(error.contains(wanted), "{wanted}: {error}");
    }
    let error = load_arm("kinova_gen4", &bench.options).unwrap_err().to_string();
    assert!(error.contains("no robot `kinova_gen4`") && error.contains("kinova_gen3"), "{error}");
}

#[test]
fn a_built_in_robot_is_loaded_without_a_file() {
    let loaded =
        load_arm("kinova_gen3", &ArmOptions { cache: CachePlace::Off, ..Default::default() });
    let loaded = loaded.unwrap();
    assert_eq!(loaded.arm.robot.n_joints(), 7);
    assert!(loaded.urdf.is_none() && loaded.links.len() >= 7);
}
