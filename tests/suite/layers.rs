//! Imports run downwards only, as the table of modules in the documentation of the crate says.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

/// What each module may import, by the table in `src/lib.rs`.
fn allowed() -> BTreeMap<String, BTreeSet<String>> {
    let mut above = BTreeSet::new();
    let mut modules = BTreeMap::new();
    let rows = include_str!("../../src/lib.rs").lines().filter_map(|line| line.strip_prefix("//! | "));
    for cells in rows.map(|row| row.split('|').map(str::trim).collect::<Vec<_>>()).filter(|cells| cells.len() >= 3) {
        let words = |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_owned).collect::<BTreeSet<_>>();
        let Some(module) = words(cells[0]).into_iter().next() else { continue };
        let named = words(cells[2]);
        let imports =
            if cells[2].starts_with("all above") { above.difference(&named).cloned().collect() } else { named };
        assert!(imports.is_subset(&above), "{module} imports {imports:?}, not all of which are above it in the table");
        above.insert(module.clone());
        modules.insert(module, imports);
    }
    modules
}

/// The text of a file without comments and tests.
fn code(path: &Path) -> String {
    let text = fs::read_to_string(path).expect("a source file");
    let code = text.split("#[cfg(test)]\nmod ").next().unwrap_or_default();
    code.lines().filter(|line| !line.trim_start().starts_with("//")).map(|line| line.to_owned() + "\n").collect()
}

/// The modules of the crate that a text names.
fn imports(code: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for rest in code.split("crate::").skip(1) {
        // the first name of each path in braces
        let (mut depth, mut is_first, mut name) = (0, true, String::new());
        for c in rest.chars() {
            match c {
                'a'..='z' | 'A'..='Z' | '0'..='9' | '_' if is_first => name.push(c),
                '{' => depth += 1,
                '}' => depth -= 1,
                ' ' | '\n' => {}
                _ => is_first = false,
            }
            if !is_first || depth == 0 && c == '}' {
                found.extend(Some(std::mem::take(&mut name)).filter(|name| !name.is_empty()));
            }
            is_first |= c == ',' && depth == 1;
            if depth <= 0 && !is_first {
                break;
            }
        }
    }
    found
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let all = entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] });
    all.filter(|path| path.extension().is_some_and(|extension| extension == "rs")).collect()
}

#[test]
fn imports_run_downwards() {
    let (root, allowed) = (Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), allowed());
    for path in files(&root).into_iter().filter(|path| !path.ends_with("tests.rs")) {
        let below = path.strip_prefix(&root).expect("below");
        let module = below.components().next().expect("a name").as_os_str().to_string_lossy();
        let module = module.trim_end_matches(".rs");
        let Some(may) = allowed.get(module) else {
            assert!(["lib", "main"].contains(&module), "the table of modules in src/lib.rs lacks {module}");
            continue;
        };
        for name in imports(&code(&path)) {
            let name = match name.as_str() {
                "Scene" | "SceneError" => "scene",
                "World" => "sim",
                name => name,
            };
            let is_known = name == module || may.contains(name) || !allowed.contains_key(name);
            assert!(is_known, "{} imports {name}, which the table in src/lib.rs does not allow", below.display());
        }
    }
}

#[test]
fn every_path_of_a_tree_is_found() {
    let found = imports("use crate::{\n    a::{b, c},\n    d,\n    e::f,\n};\nlet x = crate::g::h(crate::i);");
    assert_eq!(found.into_iter().collect::<String>(), "adegi");
}
