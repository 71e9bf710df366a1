//! `shape = { mesh = "FILE" }`, and the `[[mesh]]` tables that embed the files in a scene.

use std::{collections::BTreeMap, path::Path};

use super::{LARGEST_FILE, SceneError, Table, Value, key};
use crate::{
    geometry::{self, MeshFile, Shape},
    scene::keys::is_file,
};

/// Marks the start of the meshes appended to the text of a scene.
pub(super) const MARK: &str = "\n# The meshes of this scene, so that it needs no other files:\n";

/// The source of meshes that are not embedded in the text of a scene.
#[derive(Clone, Copy)]
pub(in crate::scene) enum Files<'a> {
    /// No source.
    None,
    /// In a folder. The function is called with the file being read and the fraction done.
    Folder(&'a Path, Watch<'a>),
    /// Compiled in: names and contents.
    Given(&'static [(&'static str, &'static str)]),
}

/// Called with the name of the mesh file being read and the fraction done, from 0 to 1.
pub type Watch<'a> = &'a (dyn Fn(&str, f64) + Sync);

/// The meshes of a scene, by the name of their file.
#[derive(Clone)]
pub(in crate::scene) struct Meshes<'a> {
    files: Files<'a>,
    known: BTreeMap<String, MeshFile>,
    /// Meshes read from files, to be embedded in the text.
    text: String,
}

impl<'a> Meshes<'a> {
    /// No meshes.
    pub fn beside(files: Files<'a>) -> Meshes<'a> {
        Meshes { files, known: BTreeMap::new(), text: String::new() }
    }

    /// Adds the meshes embedded in the text.
    pub(super) fn embedded(&mut self, tables: &[Table<'_>]) -> Result<(), SceneError> {
        for table in tables {
            let file = table.text(key!(MESHES.file))?;
            let data = table.text(key!(MESHES.data))?;
            let mesh = geometry::files::from_text(&data).map_err(|error| table.error("data", error.to_string()))?;
            if self.known.insert(file, mesh).is_some() {
                return Err(table.error("file", "expected a file that no other [[mesh]] has".to_owned()));
            }
        }
        Ok(())
    }

    /// The shape in the file named by `value`; each file is read only once.
    pub(super) fn shape(&mut self, value: &Value<'_>) -> Result<Shape, SceneError> {
        let name = value
            .text()
            .filter(|name| is_file(name))
            .ok_or_else(|| value.unexpected(key!(MESHES.file).kind.expected()))?;
        if let Some(mesh) = self.known.get(name) {
            return Ok(Shape::Mesh(mesh.clone()));
        }
        let shown: String = name.escape_debug().take(200).collect();
        let given = |files: &'static [(&str, &str)]| files.iter().find(|file| file.0 == name);
        let loaded = match self.files {
            Files::Folder(folder, watch) => {
                Some(geometry::files::load(&folder.join(name), &|share| watch(&shown, share)))
            }
            Files::Given(files) => given(files).map(|(name, content)| geometry::files::from_content(name, content)),
            Files::None => None,
        };
        let loaded = loaded.ok_or_else(|| {
            let message = format!("the mesh \"{shown}\" is not in the text of the scene");
            value.error(message).with_help("load the scene from its file, or add a [[mesh]] to it")
        })?;
        let loaded = loaded.map_err(|error| value.error(format!("\"{shown}\": {error}")))?;
        let file = toml::Value::String(name.to_owned());
        self.text.push_str(&format!("[[mesh]]\nfile = {file}\ndata = \"{}\"\n", loaded.text));
        if self.text.len() as u64 > LARGEST_FILE / 4 * 3 {
            let limit = (LARGEST_FILE / 4 * 3) >> 20;
            let message =
                format!("the meshes of the scene take more than {limit} MiB as text, which recordings contain");
            return Err(value.error(message).with_help("reduce the number of triangles"));
        }
        self.known.insert(name.to_owned(), loaded.mesh.clone());
        Ok(Shape::Mesh(loaded.mesh))
    }

    /// Whether they embed more than others.
    pub fn is_longer_than(&self, others: &Meshes<'_>) -> bool {
        self.text.len() > others.text.len()
    }

    /// Adds these tables, which the text of the scene had, to those that are embedded in it.
    pub fn carry(&mut self, tables: &str) {
        self.text.insert_str(0, tables);
    }

    /// The text of a scene with its meshes embedded.
    pub fn carried_by(&self, text: &str) -> String {
        if self.text.is_empty() { text.to_owned() } else { format!("{text}{MARK}{}", self.text) }
    }
}

#[cfg(test)]
mod tests {
    use crate::{Scene, World, scene::SceneError};

    const TETRAHEDRON: &str = "v 0 0 0\nv 3 0 0\nv 0 3 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";

    fn scene(file: &str) -> String {
        format!(
            "duration = 1\n[[body]]\nname = \"a\"\nradius = 2\nshape = {{ mesh = \"{file}\" }}\nmotion = {{ fixed = [0, 0, 0] \
             }}\n[[body]]\nname = \"b\"\nradius = 1\nshape.mesh = \"{file}\"\nmotion = {{ fixed = [2, 0, 0] }}\n"
        )
    }

    /// Loads the scene from a folder with this mesh beside it.
    fn load(name: &str, file: &str, mesh: &str) -> Result<Scene, SceneError> {
        let folder = std::env::temp_dir().join(format!("meldscope-meshes-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("scene.toml"), scene(file)).unwrap();
        std::fs::write(folder.join("mesh.obj"), mesh).unwrap();
        let loaded = Scene::load(&folder.join("scene.toml"));
        std::fs::remove_dir_all(&folder).unwrap();
        loaded
    }

    #[test]
    fn a_scene_embeds_its_meshes() {
        let loaded = load("carried", "mesh.obj", TETRAHEDRON).unwrap();
        assert_eq!(loaded.vertex_count(), 8);
        assert_eq!(Scene::without_meshes(&loaded.source), scene("mesh.obj"));
        let again = Scene::parse(&loaded.source, "scene.toml").unwrap(); // the file is gone
        assert_eq!(again.source, loaded.source);
        assert_eq!(again.bodies[1].shape, loaded.bodies[0].shape);
        let run = |scene: Scene| {
            let mut world = World::new(scene).unwrap();
            (0..60).for_each(|_| _ = world.step());
            let moved = (0..4).map(|vertex| world.body(1).displacement(vertex).length()).fold(0.0, f64::max);
            assert!(moved > 0.0);
            world.checksum()
        };
        assert_eq!(run(again), run(loaded));
    }

    #[test]
    fn an_invalid_mesh_is_rejected_with_its_position() {
        let error = |name, file, mesh| load(name, file, mesh).unwrap_err().to_string();
        let open = error("open", "mesh.obj", "v 0 0 0\nv 3 0 0\nv 0 3 0\nf 1 3 2\n");
        assert!(
            open.contains("scene.toml:5:18: body[\"a\"].shape.mesh: \"mesh.obj\": it is not closed: at 3 of its edges"),
            "{open}"
        );
        let missing = error("missing", "nothing.obj", "");
        assert!(missing.contains("\"nothing.obj\": cannot read it: "), "{missing}");
        let bad = error("bad", "mesh.obj", "v 0 0\n");
        assert!(bad.contains("not a usable OBJ file: line 1: a number is missing"), "{bad}");
        let none = Scene::parse(&scene("mesh.obj"), "x.toml").unwrap_err().to_string();
        assert!(none.contains("the mesh \"mesh.obj\" is not in the text of the scene"), "{none}");
        let damaged = format!("{}[[mesh]]\nfile = \"mesh.obj\"\ndata = \"AQQBAAAA\"\n", scene("mesh.obj"));
        let damaged = Scene::parse(&damaged, "x.toml").unwrap_err().to_string();
        assert!(damaged.contains("mesh[0].data: not a usable embedded mesh file: it ends"), "{damaged}");
    }
}
