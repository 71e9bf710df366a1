//! One cube in every format, every flaw, and damaged files.

use super::*;
use proptest::prelude::*;
use serde_json::Value;

const CORNERS: [[f32; 3]; 8] = [
    [0.0, 0.0, 0.0],
    [2.0, 0.0, 0.0],
    [2.0, 2.0, 0.0],
    [0.0, 2.0, 0.0],
    [0.0, 0.0, 2.0],
    [2.0, 0.0, 2.0],
    [2.0, 2.0, 2.0],
    [0.0, 2.0, 2.0],
];
const FACES: [[u32; 4]; 6] = [[3, 2, 1, 0], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];

fn triangles() -> Vec<[u32; 3]> {
    FACES.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect()
}

fn cube() -> Soup {
    let positions = CORNERS.iter().map(|c| DVec3::from_array(c.map(f64::from))).collect();
    Soup { positions, triangles: triangles() }
}

fn obj() -> Vec<u8> {
    let mut text = "# a cube\nmtllib none.mtl\no cube\n".to_owned();
    CORNERS.iter().for_each(|[x, y, z]| text += &format!("v {x} {y} {z}\nvn 0 0 1\n"));
    FACES.iter().for_each(|f| text += &format!("f {}/1/1 {}//2 {} -{}\n", f[0] + 1, f[1] + 1, f[2] + 1, 8 - f[3]));
    text.into_bytes()
}

fn stl() -> Vec<u8> {
    let mut bytes = b"solid but binary".to_vec();
    bytes.resize(80, 0);
    bytes.extend(12_u32.to_le_bytes());
    for triangle in triangles() {
        bytes.extend([0; 12]);
        triangle.iter().flat_map(|&c| CORNERS[c as usize]).for_each(|x| bytes.extend(x.to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

fn ascii_stl() -> Vec<u8> {
    let mut text = "solid cube\n".to_owned();
    for triangle in triangles() {
        text += "facet normal 0 0 0\n outer loop\n";
        triangle.iter().for_each(|&c| {
            let [x, y, z] = CORNERS[c as usize];
            text += &format!("  vertex {x} {y:e} {z}\n");
        });
        text += " endloop\nendfacet\n";
    }
    text.into_bytes()
}

fn ply(form: &str) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat {form} 1.0\ncomment a cube\nelement vertex 8\nproperty uchar red\nproperty float x\nproperty double y\n\
         property float z\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n"
    )
    .into_bytes();
    let big = form == "binary_big_endian";
    let order = |bytes: &[u8]| if big { bytes.iter().rev().copied().collect() } else { bytes.to_vec() };
    for [x, y, z] in CORNERS {
        if form == "ascii" {
            bytes.extend(format!("255 {x} {y} {z}\n").into_bytes());
        } else {
            bytes.push(255);
            bytes.extend(order(&x.to_le_bytes()));
            bytes.extend(order(&f64::from(y).to_le_bytes()));
            bytes.extend(order(&z.to_le_bytes()));
        }
    }
    for face in FACES {
        if form == "ascii" {
            bytes.extend(format!("4 {} {} {} {}\n", face[0], face[1], face[2], face[3]).into_bytes());
        } else {
            bytes.push(4);
            face.iter().for_each(|corner| bytes.extend(order(&(*corner as i32).to_le_bytes())));
        }
    }
    bytes
}

/// The cube, mirrored and with y up.
fn gltf_parts() -> (Vec<u8>, String) {
    let mut bytes: Vec<u8> = CORNERS.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    triangles().iter().flatten().for_each(|&c| bytes.extend((c as u16).to_le_bytes()));
    let json = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],
        "nodes":[{"children":[1],"translation":[5,0,0]},{"mesh":0,"scale":[-1,1,1]}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":8,"type":"VEC3"},
                     {"bufferView":1,"componentType":5123,"count":36,"type":"SCALAR"}],
        "bufferViews":[{"buffer":0,"byteLength":96},{"buffer":0,"byteOffset":96,"byteLength":72}],
        "buffers":[{"byteLength":168URI}]}"#;
    (bytes, json.to_owned())
}

fn gltf() -> Vec<u8> {
    use base64::Engine as _;
    let (bytes, json) = gltf_parts();
    let data = base64::engine::general_purpose::STANDARD.encode(bytes);
    json.replace("URI", &format!(",\"uri\":\"data:application/octet-stream;base64,{data}\"")).into_bytes()
}

fn glb() -> Vec<u8> {
    let (binary, json) = gltf_parts();
    let json = json.replace("URI", "").into_bytes();
    let mut bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", binary)] {
        bytes.extend((chunk.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(chunk);
    }
    bytes
}

fn parse(extension: &str, bytes: &[u8]) -> Result<Soup, String> {
    match extension {
        "obj" => obj::parse(bytes),
        "stl" => stl::parse(bytes),
        "ply" => ply::parse(bytes),
        _ => gltf::parse(bytes, Path::new("nowhere/x.gltf")),
    }
    .and_then(Soup::in_range)
}

fn all() -> Vec<(&'static str, Vec<u8>)> {
    let ply = ["ascii", "binary_little_endian", "binary_big_endian"].map(|form| ("ply", ply(form)));
    [("obj", obj()), ("stl", stl()), ("stl", ascii_stl()), ("gltf", gltf()), ("gltf", glb())]
        .into_iter()
        .chain(ply)
        .collect()
}

#[test]
fn every_format_has_the_same_cube() {
    for (extension, bytes) in all() {
        let soup = closed::closed(parse(extension, &bytes).unwrap(), &|_| ()).unwrap();
        assert_eq!((soup.positions.len(), soup.triangles.len()), (8, 12), "{extension}");
        let low = soup.positions.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let high = soup.positions.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        let expected = if extension == "gltf" {
            (DVec3::new(3.0, -2.0, 0.0), DVec3::new(5.0, 0.0, 2.0))
        } else {
            (DVec3::ZERO, DVec3::splat(2.0))
        };
        assert_eq!((low, high), expected, "{extension}");
        let mesh = finish(soup).mesh().clone();
        assert!(mesh.positions().iter().all(|p| (p.length() - 1.0).abs() < 1e-15));
        assert!((mesh.shares().iter().sum::<f64>() - 1.0).abs() < 1e-15);
    }
}

/// Variants that other programs write: continued lines, a byte-order mark, capitals, trailing bytes.
#[test]
fn unusual_files_have_the_same_cube() {
    let own = String::from_utf8(obj()).unwrap();
    let ascii = String::from_utf8(ascii_stl()).unwrap();
    let mut longer = stl();
    longer.extend([0; 7]);
    let windows = own.replace('\n', "\r\n");
    for (extension, bytes) in [
        ("obj", own.replace(" -", " \\\n -").into_bytes()),
        ("obj", windows.replace(" -", " \\\r\n-").into_bytes()),
        ("obj", format!("\u{feff}{own}").into_bytes()),
        ("stl", ascii.to_ascii_uppercase().into_bytes()),
        ("stl", ascii.replace('\n', "\r\n").into_bytes()),
        ("stl", longer),
    ] {
        let soup = closed::closed(parse(extension, &bytes).unwrap(), &|_| ()).unwrap();
        assert_eq!((soup.positions.len(), soup.triangles.len()), (8, 12), "{extension}");
    }
}

/// Small files that name one part of them many times, or need time that grows with the square of their size.
#[test]
fn what_a_file_takes_is_limited() {
    let plain: Value = serde_json::from_slice(&gltf()).unwrap();
    // 80,000 instances of a mesh of 700 primitives without a triangle
    let mut many = plain.clone();
    let mut empty = plain["accessors"][0].clone();
    empty["count"] = 0.into();
    many["accessors"].as_array_mut().unwrap().push(empty);
    let primitive = serde_json::json!({"attributes": {"POSITION": 2}});
    many["meshes"] = serde_json::json!([{"primitives": vec![primitive; 700]}]);
    many["nodes"] = serde_json::json!([{"children": vec![1; 200]}, {"children": vec![2; 400]}, {"mesh": 0}]);
    let error = parse("gltf", many.to_string().as_bytes()).unwrap_err();
    assert!(error.contains("more than 1000000 primitives"), "{error}");
    // one buffer, 3 GiB in all
    let mut large = plain.clone();
    large["buffers"] = vec![serde_json::json!({"byteLength": 1}); 3000].into();
    let mut glb = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, chunk) in [(b"JSON", large.to_string().into_bytes()), (b"BIN\0", vec![0; 1 << 20])] {
        glb.extend((chunk.len() as u32).to_le_bytes());
        glb.extend(kind);
        glb.extend(chunk);
    }
    let error = parse("gltf", &glb).unwrap_err();
    assert!(error.contains("more than 1024 MiB together"), "{error}");
    let error = parse("gltf", format!("[{}0]", "0,".repeat(4_000_000)).as_bytes()).unwrap_err();
    assert!(error.contains("more than 4000000 values"), "{error}");

    // a line of a million parts: minutes, if each part copied those before it
    let own = String::from_utf8(obj()).unwrap();
    let long = own.replacen("v 2", &format!("v {} 2", "\\\n".repeat(1_000_000)), 1);
    assert_eq!(parse("obj", long.as_bytes()).unwrap().triangles.len(), 12);
}

#[test]
fn embedding_a_mesh_is_bit_exact() {
    let third = DVec3::splat(1.0 / 3.0);
    let double = Soup { positions: cube().positions.iter().map(|p| *p + third).collect(), triangles: triangles() };
    for soup in [cube(), double] {
        let soup = closed::closed(soup, &|_| ()).unwrap();
        let text = embedded::encode(&soup);
        assert_eq!(embedded::decode(&text).unwrap(), soup);
        let again = from_text(&text).unwrap();
        assert_eq!((again.label(), again.mesh()), (finish(soup.clone()).label(), finish(soup).mesh()));
    }
}

#[test]
fn every_flaw_is_reported() {
    let flaw = |change: &dyn Fn(&mut Soup)| {
        let mut soup = cube();
        change(&mut soup);
        closed::closed(soup, &|_| ()).unwrap_err()
    };
    assert_eq!(flaw(&|soup| soup.triangles.clear()), Flaw::Empty);
    let open = flaw(&|soup| _ = soup.triangles.pop());
    assert!(matches!(open, Flaw::Open { count: 3, .. }), "{open}");
    assert!(open.to_string().contains("at 3 of its edges there is one triangle only"), "{open}");
    let inconsistent = flaw(&|soup| soup.triangles[0].swap(0, 1));
    assert!(matches!(inconsistent, Flaw::Inconsistent { count: 3, .. }), "{inconsistent}");
    let inside_out = flaw(&|soup| soup.triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1)));
    assert!(matches!(inside_out, Flaw::InsideOut { volume } if (volume + 8.0).abs() < 1e-12), "{inside_out}");
    let flat = flaw(&|soup| soup.positions.iter_mut().for_each(|position| position.z = 0.5 * position.x));
    assert_eq!(flat, Flaw::Flat);
    let at_corner = flaw(&|soup| {
        let other = cube();
        soup.positions.extend(other.positions.iter().map(|p| *p + DVec3::splat(2.0)));
        soup.triangles.extend(other.triangles.iter().map(|t| t.map(|c| c + 8)));
    });
    assert_eq!(at_corner, Flaw::Pinched { count: 1, position: DVec3::splat(2.0) });
    let at_edge = flaw(&|soup| {
        let other = cube();
        soup.positions.extend(other.positions.iter().map(|p| *p + DVec3::new(2.0, 2.0, 0.0)));
        soup.triangles.extend(other.triangles.iter().map(|t| t.map(|c| c + 8)));
    });
    assert!(matches!(at_edge, Flaw::Crowded { count: 1, .. }), "{at_edge}");
    let crossing = flaw(&|soup| {
        let other = cube();
        soup.positions.extend(other.positions.iter().map(|p| *p + DVec3::new(1.0, 0.5, 0.25)));
        soup.triangles.extend(other.triangles.iter().map(|t| t.map(|c| c + 8)));
    });
    assert!(matches!(crossing, Flaw::Meets { .. }), "{crossing}");
    assert!(crossing.to_string().contains("the triangles about ["), "{crossing}");
    let with_piece = |size: f64, at: f64, is_turned: bool| {
        let mut soup = cube();
        soup.positions.extend(cube().positions.iter().map(|p| size * *p + DVec3::splat(at)));
        soup.triangles.extend(cube().triangles.iter().map(|t| t.map(|c| c + 8)).map(|[a, b, c]| match is_turned {
            true => [a, c, b],
            false => [a, b, c],
        }));
        closed::closed(soup, &|_| ()).and_then(|soup| closed::check_nesting(&soup))
    };
    // a cavity, and a second piece beside the first
    assert_eq!([with_piece(0.5, 0.1, true), with_piece(0.5, 3.0, false)], [Ok(()); 2]);
    for (at, is_turned) in [(0.1, false), (3.0, true)] {
        let nested = with_piece(0.5, at, is_turned).unwrap_err();
        assert!(matches!(nested, Flaw::Nested { .. }), "{nested}");
    }
    let infinite = flaw(&|soup| soup.positions[3].y = f64::INFINITY);
    assert!(matches!(infinite, Flaw::NotFinite { vertex: 3, .. }), "{infinite}");
    let flat = flaw(&|soup| soup.positions.iter_mut().for_each(|p| *p = DVec3::X * (p.x + 2.0 * p.y + 4.0 * p.z)));
    assert!(matches!(flat, Flaw::Massless { count: 8, .. }), "{flat}");
}

/// glTF names files by URIs.
#[test]
fn the_names_of_buffers_may_be_percent_encoded() {
    let folder = std::env::temp_dir().join(format!("meldscope-buffers-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let (bytes, json) = gltf_parts();
    for (uri, name) in
        [("my%20cub%C3%A9.bin", "my cubé.bin"), ("my%20own.bin", "my%20own.bin"), ("100%.bin", "100%.bin")]
    {
        std::fs::write(folder.join(name), &bytes).unwrap();
        let json = json.replace("URI", &format!(",\"uri\":\"{uri}\""));
        let soup = gltf::parse(json.as_bytes(), &folder.join("x.gltf")).unwrap();
        assert_eq!(soup.positions.len(), 8, "{uri}");
    }
    let error =
        gltf::parse(json.replace("URI", ",\"uri\":\"no%20file\"").as_bytes(), &folder.join("x.gltf")).unwrap_err();
    assert!(error.contains("no file"), "{error}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn only_regular_files_are_read() {
    for path in ["/dev/zero", "/dev/null", "/", "/nowhere/x.obj"] {
        assert!(load(Path::new(path), &|_| ()).is_err());
        assert!(read(Path::new(path)).is_err(), "{path}");
    }
}

proptest! {
    /// Damaged files are rejected or read, and allocate no more than their size justifies.
    #[test]
    fn damaged_files_cause_no_panic(
        which in 0..8_usize,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in any::<prop::sample::Index>(),
        is_cut in any::<bool>(),
    ) {
        let (extension, mut bytes) = all().swap_remove(which);
        damage.iter().for_each(|(at, byte)| { let at = at.index(bytes.len()); bytes[at] = *byte; });
        if is_cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(soup) = parse(extension, &bytes) {
            _ = closed::closed(soup, &|_| ());
        }
    }

    #[test]
    fn damaged_texts_cause_no_panic(at in any::<prop::sample::Index>(), byte in any::<u8>()) {
        let mut bytes = embedded::encode(&cube()).into_bytes();
        let at = at.index(bytes.len());
        bytes[at] = byte & 0x7f;
        _ = from_text(std::str::from_utf8(&bytes).unwrap());
    }
}
