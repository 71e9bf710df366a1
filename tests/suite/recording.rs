//! Recordings read back through the SDK's dataframe API.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::File,
    path::{Path, PathBuf},
};

use rerun::{
    ChunkStore, ChunkStoreConfig, ChunkStoreHandle, Loggable, StoreId, TimelineName,
    dataframe::{EntityPath, QueryEngine, QueryExpression, SparseFillStrategy, StorageEngine},
    external::{
        arrow::array::{Array as _, ArrayRef, AsArray as _},
        re_chunk_store::{ColumnDescriptor, StaticColumnSelection},
    },
};

/// A recording, read back.
pub struct Recording {
    pub id: StoreId,
    store: ChunkStoreHandle,
    engine: QueryEngine<StorageEngine>,
}

#[test]
fn dump() {
    use meldscope::{Scene, World, stream::{Recorder, Settings, sinks::{Sinks, Destinations}}};
    let scene = Scene::builtin("two").unwrap();
    let settings = Settings::of(&scene);
    let mut world = World::new(scene).unwrap();
    let path = std::env::temp_dir().join("dump.rrd");
    let mut sinks = Sinks::open(&Destinations { save: Some(path.clone()), ..Destinations::default() }).unwrap();
    let mut recorder = Recorder::new(&world, settings);
    for m in recorder.blueprint(&world).into_iter().chain(recorder.take()) { sinks.send(m).unwrap(); }
    for _ in 0..world.scene().steps() { world.step(); recorder.observe(&world); 
        if recorder.frames() % 64 == 0 {
    for m in recorder.take() { sinks.send(m).unwrap(); } }
    }
    recorder.finish(&world);
    for m in recorder.take() { sinks.send(m).unwrap(); }
    sinks.finish().unwrap();
    let stores = ChunkStore::handle_from_rrd_reader(&ChunkStoreConfig::ALL_DISABLED, File::open(&path).unwrap()).unwrap();
    for (id, store) in stores {
        println!("{id:?}");
        let engine = QueryEngine::from_store(store.clone());
        for e in store.read().all_entities_sorted() {
            let q = QueryExpression { view_contents: Some([(e.clone(), None)].into_iter().collect()), filtered_index: Some(TimelineName::from("step")), ..Default::default() };
            let mut h = engine.query(q);
            println!("{e} {:?}", h.num_rows());
            for (_, d) in h.selected_contents() { match d { ColumnDescriptor::Component(c) => println!("   {} {} static {}", c.component, c.component_type.map(|c| c.to_string()).unwrap_or_default(), c.is_static), d => println!("   {d:?}") } }
            if let Some(row) = h.next_row() { for a in row.iter().take(2) { println!("   - {a:?}"); } println!("{}", row.len()) }
        }
    }
}
