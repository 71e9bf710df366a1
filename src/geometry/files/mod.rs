//! Closed triangle meshes from files: OBJ, STL, PLY, glTF and GLB.
//!
//! | contents | module |
//! | --- | --- |
//! | one file per format | `obj`, `stl`, `ply`, `gltf` |
//! | checks that the triangles are the surface of a body | [`closed`] |
//! | a mesh as text, exactly, as recordings store it | [`embedded`] |
//!
//! The readers read positions and triangles and skip everything else. They are our own, a few dozen lines each, and do
//! not trust the file: crates for these formats allocate whatever the header claims, or panic on an index out of range.
//! Polygons are triangulated as fans from their first corner. glTF is y-up by its specification, scenes are z-up:
//! (x, y, z) becomes (x, −z, y).

pub mod closed;
pub mod embedded;
mod gltf;
mod obj;
mod ply;
mod stl;

use std::{fmt, fs, hash, io::Read as _, path::Path, sync::Arc};

use glam::DVec3;

use super::{Mesh, Vectors};
pub use closed::Flaw;

/// Largest size of a file [bytes].
pub const LARGEST_FILE: u64 = 1 << 30;
/// Largest number of triangles of a mesh.
pub const MOST_TRIANGLES: usize = 20_000_000;

/// A mesh from a file or from the text of a scene. Meshes with equal content are equal, whatever their source.
#[derive(Clone)]
pub struct MeshFile {
    mesh: Arc<Mesh>,
    /// Unique to the content: letters, digits and `_`.
    label: Arc<str>,
}

impl MeshFile {
    /// The mesh, centred at its mass centre and of radius 1.
    pub fn mesh(&self) -> &Arc<Mesh> {
        &self.mesh
    }

    /// A label unique to the content: letters, digits and `_`.
    pub fn label(&self) -> &str {
        &self.label
    }
}

impl fmt::Debug for MeshFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("MeshFile").field(&self.label).finish()
    }
}

impl PartialEq for MeshFile {
    fn eq(&self, other: &MeshFile) -> bool {
        self.label == other.label
    }
}

impl Eq for MeshFile {}

impl hash::Hash for MeshFile {
    fn hash<H: hash::Hasher>(&self, state: &mut H) {
        self.label.hash(state);
    }
}

/// Why a mesh is rejected, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum MeshError {
    /// The file cannot be read.
    #[error("cannot read it: {0}")]
    Io(#[from] std::io::Error),
    /// It is not a regular file, or too large.
    #[error("{0}")]
    Refused(String),
    /// The content is not valid in its format.
    #[error("not a usable {format} file: {what}")]
    Format {
        /// Name of the format.
        format: &'static str,
        /// What is wrong, and where.
        what: String,
    },
    /// The triangles are not the surface of a body.
    #[error(transparent)]
    Flaw(#[from] Flaw),
}

/// Positions and triangles as read from a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Soup {
    /// Positions [any unit].
    pub positions: Vec<DVec3>,
    /// Indices into the positions, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Soup {
    /// Adds a polygon as a fan of triangles from its first corner.
    fn polygon(&mut self, corners: &[u32]) -> Result<(), String> {
        if corners.len() < 3 {
            return Err(format!("a face of {} corners", corners.len()));
        }
        if self.triangles.len() + corners.len() > MOST_TRIANGLES {
            return Err(format!("more than {MOST_TRIANGLES} triangles"));
        }
        self.triangles.extend(corners[1..].windows(2).map(|two| [corners[0], two[0], two[1]]));
        Ok(())
    }

    /// Fails if a triangle has a corner that does not exist.
    fn in_range(self) -> Result<Soup, String> {
        let count = self.positions.len();
        match self.triangles.iter().flatten().find(|&&corner| corner as usize >= count) {
            Some(corner) => Err(format!("a triangle refers to vertex {corner} (counted from 0) of only {count}")),
            None => Ok(self),
        }
    }
}

/// A closed mesh, and its text; see [`embedded`].
pub struct Loaded {
    /// The mesh.
    pub mesh: MeshFile,
    /// The welded positions and triangles as text, exactly.
    pub text: String,
}

/// Reads the file at `path`; its extension determines the format. `watch` is called with the fraction done, from 0 to
/// 1.
///
/// # Errors
/// The file cannot be read, is not a regular file, is larger than [`LARGEST_FILE`] or not valid, or its triangles are
/// not the surface of a body.
pub fn load(path: &Path, watch: &dyn Fn(f64)) -> Result<Loaded, MeshError> {
    let format = format(path)?;
    let bytes = read(path)?;
    watch(READ);
    finished(format, bytes, path, watch)
}

/// Like [`load`], for the content of a file named `name`.
///
/// # Errors
/// The content is not valid, or its triangles are not the surface of a body.
pub fn from_content(name: &str, content: &str) -> Result<Loaded, MeshError> {
    let path = Path::new(name);
    finished(format(path)?, content.as_bytes().to_vec(), path, &|_| ())
}

/// Fractions of loading at which the file has been read and parsed.
const READ: f64 = 0.05;
const PARSED: f64 = 0.3;

type Parse = fn(&[u8], &Path) -> Result<Soup, String>;

/// The format of a file by its extension, and its reader.
fn format(path: &Path) -> Result<(&'static str, Parse), MeshError> {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    Ok(match extension.as_str() {
        "obj" => ("OBJ", |bytes, _| obj::parse(bytes)),
        "stl" => ("STL", |bytes, _| stl::parse(bytes)),
        "ply" => ("PLY", |bytes, _| ply::parse(bytes)),
        "gltf" => ("glTF", gltf::parse),
        "glb" => ("GLB", gltf::parse),
        _ => return Err(MeshError::Refused("expected a file that ends in .obj, .stl, .ply, .gltf or .glb".to_owned())),
    })
}

fn finished(
    (format, parse): (&'static str, Parse),
    bytes: Vec<u8>,
    path: &Path,
    watch: &dyn Fn(f64),
) -> Result<Loaded, MeshError> {
    let soup = parse(&bytes, path).and_then(Soup::in_range).map_err(|what| MeshError::Format { format, what })?;
    drop(bytes);
    watch(PARSED);
    let soup = closed::closed(soup, &|share| watch(PARSED + (1.0 - PARSED) * share))?;
    closed::check_nesting(&soup)?;
    let text = embedded::encode(&soup);
    Ok(Loaded { mesh: finish(soup), text })
}

/// The mesh of a [`Loaded::text`].
///
/// # Errors
/// The text is not an embedded mesh, or its triangles are not the surface of a body.
pub fn from_text(text: &str) -> Result<MeshFile, MeshError> {
    let soup = embedded::decode(text).and_then(Soup::in_range);
    let soup = soup.map_err(|what| MeshError::Format { format: "embedded mesh", what })?;
    Ok(finish(closed::closed(soup, &|_| ())?))
}

fn finish(soup: Soup) -> MeshFile {
    let mut digest = [0xcbf2_9ce4_8422_2325_u64, 0x6c62_272e_07bb_0142];
    let mut add = |word: u64| {
        digest[0] = (digest[0] ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29);
        digest[1] = (digest[1].rotate_left(23) ^ word).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
    };
    soup.positions.iter().flat_map(|p| p.to_array()).for_each(|x| add(x.to_bits()));
    soup.triangles.iter().flatten().for_each(|&corner| add(u64::from(corner)));
    let positions: Vectors = soup.positions.into_iter().collect();
    let label = format!("mesh_{:016x}{:016x}", digest[0] ^ digest[0] >> 31, digest[1] ^ digest[1] >> 31);
    MeshFile { mesh: Arc::new(Mesh::new(positions, soup.triangles)), label: label.into() }
}

/// The content of a file, if it is a regular file and not too large.
fn read(path: &Path) -> Result<Vec<u8>, MeshError> {
    // checked before opening, because opening a pipe blocks until it has a writer
    if !fs::metadata(path)?.is_file() {
        return Err(MeshError::Refused("expected a regular file".to_owned()));
    }
    let file = fs::File::open(path)?;
    let metadata = file.metadata()?;
    if !metadata.is_file() {
        return Err(MeshError::Refused("expected a regular file".to_owned()));
    }
    let too_large = || MeshError::Refused(format!("larger than {} MiB, the limit for mesh files", LARGEST_FILE >> 20));
    if metadata.len() > LARGEST_FILE {
        return Err(too_large());
    }
    let mut bytes = Vec::new();
    file.take(LARGEST_FILE + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > LARGEST_FILE { Err(too_large()) } else { Ok(bytes) }
}

/// The next number of a line.
fn number<'a>(words: &mut impl Iterator<Item = &'a str>, line: usize) -> Result<f64, String> {
    let word = words.next().ok_or_else(|| format!("line {line}: a number is missing"))?;
    word.parse().map_err(|_| format!("line {line}: \"{}\" is not a number", word.chars().take(32).collect::<String>()))
}

fn text(bytes: &[u8]) -> Result<&str, String> {
    std::str::from_utf8(bytes).map_err(|error| format!("not text: byte {} is not UTF-8", error.valid_up_to()))
}

#[cfg(test)]
mod tests;
