//! Finds the mesh files that a URDF refers to, such as `package://…`.

use super::xml;
use crate::input;
use percent_encoding::percent_decode_str;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Folders in which meshes are searched.
#[derive(Debug, Clone, Default)]
pub(super) struct Search {
    /// Folder of the URDF.
    pub(super) urdf_folder: PathBuf,
    /// Folders of packages: the package itself or its parent folder.
    pub(super) packages: Vec<PathBuf>,
}

impl Search {
    /// The given folders first, then those of `ROS_PACKAGE_PATH` and `AMENT_PREFIX_PATH`.
    pub(super) fn new(urdf_folder: &Path, given: &[PathBuf]) -> Self {
        let listed = |name| std::env::var_os(name).unwrap_or_default();
        let mut packages = given.to_vec();
        packages.extend(std::env::split_paths(&listed("ROS_PACKAGE_PATH")));
        packages.extend(
            std::env::split_paths(&listed("AMENT_PREFIX_PATH")).map(|prefix| prefix.join("share")),
        );
        packages.retain(|folder| folder.is_absolute() || given.contains(folder));
        Self { urdf_folder: urdf_folder.to_owned(), packages }
    }

    /// The file that `written` in a URDF refers to; the error lists all paths that were tried.
    pub(super) fn find(&self, written: &str) -> Result<PathBuf, Vec<PathBuf>> {
        let candidates = match written.split_once("://") {
            Some(("package" | "model", rest)) => {
                let (package, file) = rest.split_once('/').unwrap_or((rest, ""));
                self.in_package(package, file)
            }
            Some(("file", path)) => vec![PathBuf::from(path), PathBuf::from(unescaped(path))],
            Some(_) => vec![],
            // `join` returns `written` if it is an absolute path.
            None => vec![self.urdf_folder.join(written)],
        };
        match candidates.iter().find(|path| path.is_file()) {
            Some(path) => Ok(path.clone()),
            None => Err(candidates),
        }
    }

    /// The URDF's folder and the folders above it. If the URDF is in a package (a folder with
    /// `package.xml`), the last one is the parent of the package.
    fn above(&self) -> impl Iterator<Item = &Path> {
        let mut folders = self.urdf_folder.ancestors();
        let own = folders.position(|folder| folder.join("package.xml").is_file());
        self.urdf_folder.ancestors().take(own.map_or(usize::MAX, |own| own + 2))
    }

    /// Possible paths of a file of a package, the most likely first.
    fn in_package(&self, package: &str, file: &str) -> Vec<PathBuf> {
        let above = || self.above();
        let mut candidates = Vec::new();
        for folder in self.packages.iter().map(PathBuf::as_path).chain(above()) {
            if is_package(folder, package) {
                candidates.push(folder.join(file));
            }
            candidates.push(folder.join(package).join(file));
        }
        // The package may have been copied under another name.
        candidates.extend(above().map(|folder| folder.join(file)));
        let mut taken = HashSet::new();
        candidates.retain(|candidate| taken.insert(candidate.clone()));
        candidates
    }
}

/// Largest size of `package.xml`, bytes.
const MANIFEST: u64 = 1 << 20;

/// Whether a folder is the package with this name, by the folder's name or by its `package.xml`.
fn is_package(folder: &Path, package: &str) -> bool {
    if folder.file_name().is_some_and(|name| name == package) {
        return true;
    }
    let manifest = folder.join("package.xml");
    let Ok(text) = input::read_text(&manifest, MANIFEST) else { return false };
    let Ok(document) = xml::parse(&text) else { return false };
    let mut children = document.root_element().children();
    let name = children.find(|node| node.has_tag_name("name"));
    name.and_then(|node| node.text()).is_some_and(|name| name.trim() == package)
}

/// Decodes percent-encoded characters, such as `%20`.
fn unescaped(path: &str) -> String {
    percent_decode_str(path).decode_utf8_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    /// Creates an empty file and the folders above it.
    fn touch(path: &Path) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "").unwrap();
    }

    #[test]
    fn a_package_is_found_by_folder_by_manifest_and_by_what_it_holds() {
        let root = tempfile::tempdir().unwrap();
        let at = |path: &str| root.path().join(path);
        touch(&at("named/arm/meshes/a.stl"));
        touch(&at("cloned/meshes/b.stl"));
        fs::write(at("cloned/package.xml"), "<package><name> arm </name></package>").unwrap();
        touch(&at("copied/meshes/c.stl"));

        let find = |urdf_folder: &str, packages: &[&str], written: &str| {
            let packages = packages.iter().map(|folder| at(folder)).collect();
            Search { urdf_folder: at(urdf_folder), packages }.find(written)
        };
        let (a, b, c) =
            (at("named/arm/meshes/a.stl"), at("cloned/meshes/b.stl"), at("copied/meshes/c.stl"));
        let [wa, wb, wc] = ["a", "b", "c"].map(|name| format!("package://arm/meshes/{name}.stl"));
        assert_eq!(find("x", &["named"], &wa), Ok(a.clone()), "a folder of packages");
        assert_eq!(find("x", &["named/arm"], &wa), Ok(a.clone()), "the package itself");
        assert_eq!(find("named/arm/urdf", &[], &wa), Ok(a), "upwards, by its name");
        assert_eq!(find("cloned/urdf/deep", &[], &wb), Ok(b), "upwards, by its manifest");
        assert_eq!(find("copied/urdf", &[], &wc), Ok(c), "upwards, by what it holds");

        let looked = find("x", &["named"], "package://arm/meshes/z.stl").unwrap_err();
        assert_eq!(looked[0], at("named/arm/meshes/z.stl"));
    }

    #[test]
    fn other_paths_are_relative_absolute_or_addresses() {
        let root = tempfile::tempdir().unwrap();
        let file = root.path().join("with blank/a.stl");
        touch(&file);
        let search = Search { urdf_folder: root.path().to_owned(), packages: vec![] };
        let escaped = format!("file://{}", file.display().to_string().replace(' ', "%20"));
        for written in ["with blank/a.stl", &file.display().to_string(), &escaped] {
            assert!(search.find(written).is_ok(), "{written}");
        }
        assert_eq!(search.find("https://example.org/a.stl"), Err(vec![]));
        assert_eq!(unescaped("%4%zz%41é%"), "%4%zzAé%");
    }
}
