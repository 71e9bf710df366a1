//! Recordings are read back through the SDK's dataframe API and compared entity by entity with the state in memory: a
//! second, unrecorded world takes the same steps alongside.

use std::{
    collections::{BTreeMap, BTreeSet, HashSet},
    fs::File,
    ops::Bound::{Excluded, Included},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU32, Ordering},
};

use glam::{DMat3, DVec3, Vec3};
use meldscope::{
    Scene, World,
    geometry::{Shape, Sphere, Vectors},
    model::phase::Phase,
    observe::{Simulation, StepSummary},
    sdk::{
        self, Chunk, EntityPath, LogMsg, Loggable, RowId, StoreId, TimelineName,
        arrow::{
            array::{Array as _, ArrayRef, AsArray as _},
            datatypes::UInt64Type,
        },
        components::{AlbedoFactor, ViewCoordinates},
        datatypes::{Float64, Rgba32, UVec3D, Utf8, Vec3D},
    },
    sim::{BodyForces, BodyView, Cause, Event, PairView},
    stream::{
        Recorder, Settings,
        blueprint::Tab,
        palette,
        recorder::{Detail, Entities},
        settings::{FORMAT, Frames, MOST_PAIRS_OF_MANY},
        sinks::{Destinations, Sinks},
    },
    view::{
        scales::arrow_scale,
        terms::{phase_color, term},
    },
};
use re_dataframe::{QueryEngine, QueryExpression, SparseFillStrategy, StorageEngine, TimeInt};
use rerun::external::re_chunk_store::{
    ChunkStore, ChunkStoreConfig, ChunkStoreHandle, ColumnDescriptor, StaticColumnSelection,
};

// ---- reading -------------------------------------------------------------------------------------------------------

/// A recording, read back.
pub struct Recording {
    pub id: StoreId,
    store: ChunkStoreHandle,
    engine: QueryEngine<StorageEngine>,
}

/// The values of an entity at an instant.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    /// On the timeline `step`.
    pub step: i64,
    /// On the timeline `sim_time` [ns].
    pub time: i64,
    /// By component.
    cells: BTreeMap<String, ArrayRef>,
}

impl Recording {
    /// Opens a file, which must hold exactly one recording and its blueprint; a thin recording has no blueprint.
    pub fn open(path: &Path) -> Recording {
        let file = File::open(path).expect("a file");
        Recording::read(file)
    }

    /// Like [`Recording::open`], from any reader.
    pub fn read(bytes: impl std::io::Read) -> Recording {
        let stores = ChunkStore::handle_from_rrd_reader(&ChunkStoreConfig::ALL_DISABLED, bytes).expect("a recording");
        let (mut recordings, blueprints): (Vec<_>, Vec<_>) = stores.into_iter().partition(|(id, _)| id.is_recording());
        assert!(recordings.len() == 1 && blueprints.len() <= 1, "recordings and blueprints");
        let (id, store) = recordings.remove(0);
        for (blueprint, _) in blueprints {
            assert_eq!(blueprint.application_id(), id.application_id(), "the blueprint is for this recording");
        }
        Recording { id, engine: QueryEngine::from_store(store.clone()), store }
    }

    /// All entities.
    pub fn entities(&self) -> BTreeSet<EntityPath> {
        self.store.read().all_entities_sorted()
    }

    /// All timelines, each with its kind: sequence or duration.
    fn timelines(&self) -> BTreeSet<String> {
        let timelines = self.store.read().schema().timelines();
        timelines.values().map(|timeline| format!("{} {}", timeline.name(), timeline.typ())).collect()
    }

    fn query(&self, entity: &str, expression: QueryExpression) -> Vec<Row> {
        let view_contents = Some([(EntityPath::from(entity), None)].into_iter().collect());
        let mut handle = self.engine.query(QueryExpression {
            view_contents,
            include_semantically_empty_columns: true,
            ..expression
        });
        let columns: Vec<ColumnDescriptor> =
            handle.selected_contents().iter().map(|(_, column)| column.clone()).collect();
        let mut rows = Vec::new();
        while let Some(cells) = handle.next_row() {
            let mut row = Row::default();
            for (column, cell) in columns.iter().zip(cells) {
                if cell.is_null(0) {
                    continue;
                }
                match column {
                    ColumnDescriptor::Component(column) => {
                        row.cells.insert(column.component.to_string(), cell.as_list::<i32>().value(0));
                    }
                    ColumnDescriptor::Time(column) => {
                        let ticks = TimeTicks::from(&cell);
                        match column.timeline_name().as_str() {
                            "step" => row.step = ticks.0,
                            "sim_time" => row.time = ticks.0,
                            other => panic!("a timeline {other}"),
                        }
                    }
                    ColumnDescriptor::RowId(_) => {}
                }
            }
            rows.push(row);
        }
        rows
    }

    /// The static values of an entity.
    pub fn fixed(&self, entity: &str) -> Row {
        let include_static_columns = StaticColumnSelection::StaticOnly;
        let mut rows = self.query(entity, QueryExpression { include_static_columns, ..QueryExpression::default() });
        assert!(rows.len() < 2);
        rows.pop().unwrap_or_default()
    }

    /// The values of an entity at the steps at which it was logged, without filling in.
    pub fn changes(&self, entity: &str) -> Vec<Row> {
        let expression = QueryExpression {
            include_static_columns: StaticColumnSelection::NonStaticOnly,
            filtered_index: Some(TimelineName::from("step")),
            ..QueryExpression::default()
        };
        self.query(entity, expression)
    }

    /// The values of an entity at each of the steps, as the viewer shows them: the latest, static ones included.
    pub fn held(&self, entity: &str, steps: impl IntoIterator<Item = u64>) -> Vec<Row> {
        let expression = QueryExpression {
            filtered_index: Some(TimelineName::from("step")),
            using_index_values: Some(steps.into_iter().map(|step| TimeInt::new_temporal(step as i64)).collect()),
            sparse_fill_strategy: SparseFillStrategy::LatestAtGlobal,
            ..QueryExpression::default()
        };
        self.query(entity, expression)
    }

    /// Every non-static row of an entity, by row id; a dataframe shows one row per instant.
    pub fn rows(&self, entity: &EntityPath) -> Vec<(RowId, Row)> {
        let mut rows = Vec::new();
        let store = self.store.read();
        for chunk in store.iter_physical_chunks().filter(|chunk| chunk.entity_path() == entity && !chunk.is_static()) {
            for (index, id) in chunk.row_ids().enumerate() {
                let at = |timeline| chunk.timelines()[&timeline].times_raw()[index];
                let (step, time) = (at(TimelineName::from("step")), at(TimelineName::from("sim_time")));
                let mut row = Row { step, time, cells: BTreeMap::new() };
                for column in chunk.components().values() {
                    if !column.list_array.is_null(index) {
                        row.cells.insert(column.descriptor.component.to_string(), column.list_array.value(index));
                    }
                }
                rows.push((id, row));
            }
        }
        rows.sort_by_key(|(id, _)| *id);
        rows
    }

    /// A text property of the recording.
    pub fn property(&self, name: &str) -> String {
        self.fixed("/__properties/meldscope").text(name)
    }

    /// The number of steps, from the recording's properties.
    pub fn steps(&self) -> f64 {
        self.fixed("/__properties/meldscope").get::<Float64>("steps")[0].0
    }
}

/// A cell of a time column.
struct TimeTicks(i64);

impl From<&ArrayRef> for TimeTicks {
    fn from(cell: &ArrayRef) -> TimeTicks {
        use meldscope::sdk::arrow::{array::Int64Array, compute::cast, datatypes::DataType};
        let cell = cast(cell, &DataType::Int64).expect("a number of ticks");
        TimeTicks(cell.as_any().downcast_ref::<Int64Array>().expect("the cast type").value(0))
    }
}

impl Row {
    /// A component, deserialised by the SDK; empty if there is none.
    pub fn get<T: Loggable>(&self, component: &str) -> Vec<T> {
        self.cells.get(component).map_or_else(Vec::new, |cell| T::from_arrow(cell).expect("the type of its archetype"))
    }

    pub fn has(&self, component: &str) -> bool {
        self.cells.contains_key(component)
    }

    /// The step, and the values without the instant at which they were logged.
    pub fn values(self) -> (i64, BTreeMap<String, ArrayRef>) {
        (self.step, self.cells)
    }

    pub fn vectors(&self, component: &str) -> Vec<Vec3> {
        self.get::<Vec3D>(component).into_iter().map(|v| Vec3::from(v.0)).collect()
    }

    pub fn texts(&self, component: &str) -> Vec<String> {
        self.get::<Utf8>(component).iter().map(|text| text.as_str().to_owned()).collect()
    }

    pub fn text(&self, component: &str) -> String {
        let [text]: [String; 1] = self.texts(component).try_into().expect("one text");
        text
    }

    fn colors(&self, component: &str) -> Vec<Rgba32> {
        self.get(component)
    }

    pub fn scalar(&self) -> Option<f64> {
        let values = self.get::<Float64>("Scalars:scalars");
        assert!(values.len() < 2, "one number an instant: {values:?}");
        values.first().map(|value| value.0)
    }
}

// ---- recording -----------------------------------------------------------------------------------------------------

/// A temporary directory, removed on drop.
pub struct Dir(PathBuf);

impl Dir {
    pub fn new() -> Dir {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("meldscope-recording-{}-{number}", std::process::id()));
        std::fs::create_dir(&path).expect("a new directory");
        Dir(path)
    }

    pub fn path(&self) -> &Path {
        &self.0
    }

    pub fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    pub fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(&self.0).expect("a directory");
        let mut names: Vec<String> =
            entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }
}

impl Drop for Dir {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).ok();
    }
}

/// A run and its recording.
struct Run {
    scene: Scene,
    settings: Settings,
    recording: Recording,
}

impl Run {
    fn new(scene: &Scene) -> Run {
        Run::with(scene, Settings::of(scene), 64)
    }

    /// Records into a file; messages are taken at this interval of steps.
    fn with(scene: &Scene, settings: Settings, taken_every: u64) -> Run {
        let dir = Dir::new();
        let path = dir.file("run.rrd");
        let destinations = Destinations { save: Some(path.clone()), ..Destinations::default() };
        let mut sinks = Sinks::open(&destinations).expect("a file");
        let mut world = World::new(scene.clone()).expect("enough memory");
        let mut recorder = Recorder::new(&world, settings.clone()).expect("its text describes it");
        let mut send =
            |messages: Vec<_>| messages.into_iter().for_each(|message| sinks.send(message).expect("disk space"));
        send(recorder.blueprint(&world, Tab::Scene));
        for step in 1..=settings.steps.expect("a last step") {
            let mut summary = StepSummary::default();
            Simulation::step(&mut world, &mut summary);
            recorder.observe(&world, &summary).expect("a valid step");
            if step % taken_every == 0 {
                send(recorder.take());
            }
        }
        recorder.finish();
        send(recorder.take());
        sinks.finish().expect("disk space");
        Run { scene: scene.clone(), settings, recording: Recording::open(&path) }
    }

    fn steps(&self) -> u64 {
        self.settings.steps.expect("a last step")
    }

    /// The steps that have frames.
    fn frames(&self) -> Vec<u64> {
        (0..=self.steps()).filter(|step| step % self.settings.every == 0).collect()
    }

    /// Visits every step of an unrecorded world of the same scene.
    fn walk(&self, mut look: impl FnMut(&World)) {
        let mut world = World::new(self.scene.clone()).expect("enough memory");
        look(&world);
        for _ in 0..self.steps() {
            let _ = world.step();
            look(&world);
        }
    }

    /// The spheres that are in view at first: those that reach furthest towards the corners, edges and faces of a box.
    fn framed(&self) -> Vec<(DVec3, f64)> {
        let spheres = World::new(self.scene.clone()).expect("a valid scene").framing(true);
        let signs = [-1.0, 0.0, 1.0];
        let directions =
            signs.into_iter().flat_map(|x| signs.map(|y| (x, y))).flat_map(|(x, y)| signs.map(|z| DVec3::new(x, y, z)));
        let reach = |of: &(DVec3, f64), direction: DVec3| of.0.dot(direction.normalize_or_zero()) + of.1;
        let furthest = directions.map(|direction| {
            spheres.iter().max_by(|one, other| reach(one, direction).total_cmp(&reach(other, direction)))
        });
        furthest.flatten().copied().collect()
    }

    /// Visits the frames of an unrecorded world of the same scene, with their index.
    fn walk_frames(&self, mut look: impl FnMut(usize, &World)) {
        let mut frame = 0;
        self.walk(|world| {
            if self.is_frame(world) {
                look(frame, world);
                frame += 1;
            }
        });
        assert_eq!(frame, self.frames().len());
    }

    /// Every event, in order.
    fn events(&self) -> Vec<Event> {
        let mut events = Vec::new();
        self.walk(|world| events.extend_from_slice(&world.report().events));
        events
    }

    /// The values of an entity at each frame, and the frames at which it was logged.
    fn track(&self, entity: &str) -> Track {
        let held = self.recording.held(entity, self.frames());
        assert_eq!(held.len(), self.frames().len(), "{entity}");
        let changes = self.recording.changes(entity).into_iter().map(|row| (row.step as u64, row)).collect();
        Track { entity: entity.to_owned(), held, changes }
    }

    /// The pairs with their own entities: the first that are within reach in a frame or change phase.
    fn pairs(&self) -> Vec<(usize, usize)> {
        let mut pairs = Vec::new();
        self.walk(|world| {
            let changed = world.report().events.iter().map(|event| (event.a as usize, event.b as usize));
            let mut seen: Vec<_> = world.pairs().filter(|_| self.is_frame(world)).collect();
            seen.sort_by(|x, y| x.q.total_cmp(&y.q)); // among pairs of the same frame, the closest first
            let seen = seen.into_iter().map(|pair| (pair.a, pair.b, self.settings.pairs));
            // there is room for the same number of pairs with events
            let changed = changed.map(|(a, b)| (a, b, 2 * self.settings.pairs));
            for (a, b, most) in changed.chain(seen) {
                if pairs.len() < most && !pairs.contains(&(a, b)) {
                    pairs.push((a, b));
                }
            }
        });
        pairs
    }

    fn pair_name(&self, (a, b): (usize, usize)) -> String {
        format!("{}~{}", self.scene.bodies[a].name, self.scene.bodies[b].name)
    }

    fn is_frame(&self, world: &World) -> bool {
        world.steps_taken().is_multiple_of(self.settings.every)
    }
}

/// An entity at every frame.
struct Track {
    entity: String,
    /// The values that the viewer shows, by frame.
    held: Vec<Row>,
    /// The values that were logged, by step.
    changes: BTreeMap<u64, Row>,
}

impl Track {
    /// Whether any of these components was logged at a step; if so, all of them must have been.
    fn logged(&self, step: u64, components: &[&str]) -> bool {
        let has = |component: &&str| self.changes.get(&step).is_some_and(|row| row.has(component));
        let any = components.iter().any(has);
        assert_eq!(any, components.iter().all(has), "{} at step {step}: {components:?} belong together", self.entity);
        any
    }
}

/// A time in the units of a recording.
fn nanoseconds(time: f64) -> i64 {
    (time * 1e9).round() as i64
}

fn builtin(name: &str) -> Scene {
    Scene::builtin(name).expect("a built-in scene")
}

fn color([r, g, b]: palette::Rgb) -> Rgba32 {
    Rgba32::from_rgb(r, g, b)
}

// ---- comparison ----------------------------------------------------------------------------------------------------

impl Run {
    /// Verifies everything.
    fn verify(&self) {
        self.verify_entities();
        self.verify_rows();
        self.verify_properties();
        self.verify_checksums();
        match self.settings.entities {
            Entities::Body => self.verify_bodies(),
            Entities::Batch => self.verify_batches(),
        }
        self.verify_spheres();
        if self.settings.detail == Detail::Forces {
            self.verify_forces();
            self.verify_body_forces();
            self.verify_resultants();
            self.verify_vertices();
            self.verify_largest();
        }
        self.verify_lines();
        self.verify_recent();
        self.verify_near_misses();
        self.verify_reaching_spheres();
        self.verify_pairs();
        self.verify_events();
        self.verify_diagnostics();
        self.verify_timings();
        self.verify_volume();
        self.verify_energies();
        self.verify_groups();
    }

    /// Verifies that exactly the specified entities exist.
    fn verify_entities(&self) {
        let mut entities = vec!["/__properties".to_owned(), "/__properties/meldscope".to_owned()];
        entities.extend(["/about", "/checksum", "/world", "/world/influence"].map(str::to_owned));
        match self.settings.entities {
            Entities::Body => {
                for body in &self.scene.bodies {
                    entities.push(format!("/world/bodies/{}", body.name));
                    entities.push(format!("/world/bodies/{}/surface", body.name));
                }
            }
            Entities::Batch => {
                entities.push("/world/deforming/surface".to_owned());
                entities.extend(self.shapes().iter().map(resting));
            }
        }
        if self.settings.detail == Detail::Forces {
            entities.extend(
                ["/world/forces", "/world/resultants", "/world/resultants/labels", "/about/arrows"].map(str::to_owned),
            );
            entities.extend(Cause::of(&self.scene).map(|cause| format!("/world/forces/{}", cause.name())));
        }
        for pair in self.pairs() {
            let parts = ["distance", "phase", "merge_at", "split_at", "core_at", "gap", "overlap", "neck", "contact"];
            let parts = parts.iter().filter(|&&part| part != "core_at" || self.scene.thresholds.core_at > 0.0);
            entities.extend(parts.map(|part| format!("/pairs/{}/{part}", self.pair_name(pair))));
        }
        entities.extend((!self.events().is_empty()).then(|| "/events".to_owned()));
        if self.scene.bodies.len() > 1 {
            entities.extend(["/world/merged", "/world/merged/surface", "/world/merged/seams"].map(str::to_owned));
        }
        // these depend on groups, on touching surfaces, on the forces that act, on pushes, on how close pairs come, and on the
        // pairs drawn
        let depends = |path: &String| {
            path.starts_with("/groups/")
                || path.starts_with("/forces/")
                || path.starts_with("/strongest/")
                || path.starts_with("/marks/drawn/")
                || ["/events/surfaces", "/events/scheduled", "/marks/axis/scheduled", "/marks/q/near_miss"]
                    .contains(&path.as_str())
        };
        entities.extend(self.recording.entities().iter().map(ToString::to_string).filter(depends));
        if (2..=64).contains(&self.scene.bodies.len()) {
            entities.extend(["/volume/surfaces", "/volume/bodies"].map(str::to_owned));
        }
        entities.extend(TIMINGS.map(|stage| format!("/timings/{stage}")));
        let stacked = TIMINGS.iter().filter(|&&stage| stage != "wait").rev().zip(1..);
        entities.extend(stacked.map(|(stage, number)| format!("/timings/stacked/{number}_{stage}")));
        entities.extend(["/timings/ranking", "/timings/speed", "/timings/lag"].map(str::to_owned));
        entities.extend(["/world/pairs", "/world/recent"].map(str::to_owned));
        entities.extend((2..=32).contains(&self.scene.bodies.len()).then(|| "/world/names".to_owned()));
        if self.scene.bodies.len() > 8 {
            entities.extend(["/recent/pair", "/recent/spheres", "/recent/names"].map(str::to_owned));
        }
        if self.settings.detail == Detail::Forces {
            let always = ["/legend/bar", "/legend/ticks", "/largest", "/largest/bodies", "/ranking/forces"];
            entities.extend(always.map(str::to_owned));
            entities.extend(self.displacement_lines());
        }
        if self.scene.bodies.len() > 3 {
            let forces = (self.settings.detail == Detail::Forces).then(|| "/ranking/displacements".to_owned());
            entities.extend(forces);
            entities.extend(["/ranking/groups", "/ranking/pairs"].map(str::to_owned));
        }
        entities.push("/ranking/energies/0".to_owned());
        entities.insert(0, "/marks/axis/ends".to_owned());
        entities.extend((!self.pairs().is_empty()).then(|| "/marks/q/ends".to_owned()));
        for event in self.events() {
            entities.extend(["axis", "q"].map(|place| format!("/marks/{place}/{}", event.name().replace(' ', "_"))));
        }
        entities.extend(DIAGNOSTICS.map(|number| format!("/diagnostics/{number}")));

        let entities: BTreeSet<EntityPath> = entities.iter().map(|path| EntityPath::from(path.as_str())).collect();
        assert_eq!(self.recording.entities(), entities);
        assert_eq!(Cause::of(&self.scene).map(Cause::name).collect::<Vec<_>>(), CAUSES);

        if self.settings.detail == Detail::Forces {
            self.verify_arrows();
        }

        let up = self.recording.fixed("/world").get::<ViewCoordinates>("ViewCoordinates:xyz");
        assert_eq!(up, [ViewCoordinates::RIGHT_HAND_Z_UP]);
        let about = self.recording.fixed("/about").text("TextDocument:text");
        assert!(about.contains(&self.scene.name) && about.contains("the graduation thesis"), "{about}");
    }

    /// q with three digits, or six where these are those of a threshold.
    fn told_q(&self, q: f64) -> String {
        let thresholds = &self.scene.thresholds;
        let is_same = |level: &f64| *level > 0.0 && *level != q && format!("{level:.3}") == format!("{q:.3}");
        let is_same = [thresholds.merge_at, thresholds.split_at, thresholds.core_at].iter().any(is_same);
        if is_same { format!("{q:.6}") } else { format!("{q:.3}") }
    }

    /// Verifies that the text beside forces says how strong a force is whose arrow is as long as the largest radius.
    fn verify_arrows(&self) {
        let text = self.recording.fixed("/about/arrows").text("TextDocument:text").to_owned();
        let radius = self.scene.bodies.iter().map(|body| body.radius).fold(0.0, f64::max);
        assert!(text.contains(&format!("**{radius} unit**")), "{text}");
        for cause in Cause::of(&self.scene) {
            let term = term(&self.scene, cause);
            let list = text.split([';', ':', '\n']).find(|list| list.contains(&format!(" {}", cause.name())));
            assert_eq!(list.is_some(), term.can_act, "{}: {text}", cause.name());
            let Some((_, strength)) = list.and_then(|list| list.split_once(" = ")) else { continue };
            let strength: f64 = strength.trim_end_matches('.').trim_end_matches(" unit/s²").parse().expect("a number");
            let length = strength * term.arrow_scale.unwrap_or(arrow_scale(&self.scene));
            assert!((length - radius).abs() <= 0.01 * radius, "{}: {text}", cause.name());
        }
    }

    /// Verifies that rows are at the frames or at the exact times of events, and that no row hides another.
    fn verify_rows(&self) {
        let timelines = ["sim_time duration", "step sequence"].map(str::to_owned);
        assert_eq!(self.recording.timelines(), timelines.into());
        for entity in self.recording.entities() {
            let path = entity.to_string();
            let mut seen = HashSet::new();
            for (_, row) in self.recording.rows(&entity) {
                if path == "/checksum"
                    || path.starts_with("/events")
                    || path.starts_with("/marks/")
                    || ["/world/recent", "/recent/pair", "/recent/spheres", "/recent/names"].contains(&path.as_str())
                    // the gap where the energy jumps at an event
                    || (path.starts_with("/diagnostics/energy") && row.scalar().is_none())
                    || (path.starts_with("/pairs/") && path.ends_with("/phase"))
                {
                    continue; // checked below
                }
                assert!(
                    (row.step as u64).is_multiple_of(self.settings.every) && row.step as u64 <= self.steps(),
                    "{path}"
                );
                assert_eq!(row.time, nanoseconds(row.step as f64 * self.scene.dt), "{path} at step {}", row.step);
                for component in row.cells.into_keys() {
                    assert!(seen.insert((row.step, component.clone())), "{path} at step {}: {component}", row.step);
                }
            }
        }
    }

    fn verify_properties(&self) {
        let (recording, settings) = (&self.recording, &self.settings);
        assert_eq!(recording.property("scene"), self.scene.source);
        assert_eq!(recording.property("version"), env!("CARGO_PKG_VERSION"));
        assert_eq!(recording.property("integrator"), self.scene.integrator.name());
        assert_eq!(recording.steps(), self.steps() as f64);
        let own = Scene::parse(&self.scene.source, "own").expect("a scene");
        let changed = (own.steps() != self.steps()).then(|| format!("steps = {}\n", self.steps()));
        assert_eq!(recording.property("overrides"), changed.unwrap_or_default());
        assert_eq!(recording.fixed("/__properties/meldscope").get::<Float64>("format")[0].0, f64::from(FORMAT));
        assert!(recording.property("machine").contains(std::env::consts::ARCH));
        let info = recording.fixed("/__properties");
        assert_eq!(info.cells.keys().collect::<Vec<_>>(), ["RecordingInfo:name"], "no time of day");
        assert_eq!(info.text("RecordingInfo:name"), self.scene.name);

        let read: toml::Table = recording.property("settings").parse().expect("TOML");
        let mut expected = toml::Table::new();
        expected.insert("integrator".to_owned(), self.scene.integrator.name().into());
        expected.insert("dt".to_owned(), self.scene.dt.into());
        expected.insert("tolerance".to_owned(), self.scene.tolerance.into());
        expected.insert("steps".to_owned(), (self.steps() as i64).into());
        expected.insert("every".to_owned(), (settings.every as i64).into());
        let detail = if settings.detail == Detail::Forces { "forces" } else { "surface" };
        expected.insert("detail".to_owned(), detail.into());
        let entities = if settings.entities == Entities::Body { "body" } else { "batch" };
        expected.insert("entities".to_owned(), entities.into());
        for (key, value) in expected {
            assert_eq!(read.get(&key), Some(&value), "{key}");
        }
    }

    /// Verifies that there is a checksum for every step, whether it has a frame or not.
    fn verify_checksums(&self) {
        let mut found = self.recording.rows(&EntityPath::from("/checksum")).into_iter();
        self.walk(|world| {
            let (_, row) = found.next().expect("one per step");
            assert_eq!((row.step, row.time), (world.steps_taken() as i64, nanoseconds(world.time())));
            let values = row.cells["checksum"].as_primitive::<UInt64Type>().values().to_vec();
            assert_eq!(values, [world.checksum()], "step {}", row.step);
        });
        assert!(found.next().is_none());
    }

    /// Verifies one transform and one mesh per body.
    fn verify_bodies(&self) {
        for (index, scene) in self.scene.bodies.iter().enumerate() {
            let transform = self.track(&format!("/world/bodies/{}", scene.name));
            let surface = self.track(&format!("/world/bodies/{}/surface", scene.name));
            let fixed = self.recording.fixed(&surface.entity);
            assert_eq!(triangles(&fixed), scene.shape.mesh().triangles());
            let albedo = fixed.get::<AlbedoFactor>("Mesh3D:albedo_factor");
            assert_eq!(albedo.len(), 1, "{}", surface.entity);
            assert!(!fixed.has("Mesh3D:vertex_positions") && !fixed.has("Mesh3D:vertex_normals"), "they would shadow");

            let mut last = (None, Vec::new(), Vec::new());
            self.walk_frames(|frame, world| {
                let (body, step) = (world.body(index), world.steps_taken());
                let centre = body.centre().as_vec3();
                let held = transform.held[frame].vectors(TRANSLATION);
                assert_eq!(held, [centre], "{} at step {step}", transform.entity);
                let moved = last.0 != Some(centre);
                assert_eq!(transform.logged(step, &[TRANSLATION]), moved, "{} at step {step}", transform.entity);

                let at = format!("{} at step {step}", surface.entity);
                let held = &surface.held[frame];
                let (positions, normals) = (held.vectors(POSITIONS), held.vectors(NORMALS));
                let expected: Vec<Vec3> = (0..body.vertex_count()).map(|i| body.local_position(i).as_vec3()).collect();
                assert_same(&positions, &expected, &at);
                verify_normals(&body, &normals, &at);
                let changed = (&positions, &normals) != (&last.1, &last.2);
                assert_eq!(surface.logged(step, &[POSITIONS, NORMALS]), changed, "{at}");
                last = (Some(centre), positions, normals);
            });
            if scene.path().unwrap().is_fixed() {
                assert_eq!(transform.changes.len(), 1, "{}", transform.entity);
            }
        }
    }

    /// Verifies that bodies at rest are instances of their shapes, deformed ones are in one mesh, and each appears
    /// once.
    fn verify_batches(&self) {
        let instances: Vec<_> =
            self.shapes().iter().map(|shape| (shape.clone(), self.track(&resting(shape)))).collect();
        for (shape, track) in &instances {
            let mesh = shape.mesh();
            let rest: Vec<DVec3> = mesh.positions().iter().collect();
            let unit: Vec<Vec3> = rest.iter().map(|v| v.as_vec3()).collect();
            let drawn = &track.held[0];
            assert_eq!(drawn.vectors(POSITIONS), unit);
            let expected = area_normals(&rest, mesh.triangles());
            for (normal, expected) in drawn.vectors(NORMALS).iter().zip(expected) {
                assert!(normal.as_dvec3().distance(expected) < 1e-6, "{normal} {expected}");
            }
            assert_eq!(triangles(drawn), mesh.triangles());
        }
        let deforming = self.track("/world/deforming/surface");
        let mut last_deformed = Vec::new();
        let mut last_surface = (Vec::new(), Vec::new());
        let mut last_instances: Vec<Option<Row>> = vec![None; instances.len()];
        self.walk_frames(|frame, world| {
            let step = world.steps_taken();
            let mut drawn = BTreeMap::<String, u32>::new();
            let displaced = |i: usize| {
                let body = world.body(i);
                let largest = (0..body.vertex_count()).map(|v| body.displacement(v).length()).fold(0.0, f64::max);
                largest > 1e-6 * body.scene().radius
            };
            let (deformed, rest): (Vec<usize>, Vec<usize>) = (0..world.body_count()).partition(|&i| displaced(i));

            for ((shape, track), last) in instances.iter().zip(&mut last_instances) {
                let at = format!("{} at step {step}", track.entity);
                let held = &track.held[frame];
                let of_shape: Vec<_> =
                    rest.iter().map(|&i| world.body(i)).filter(|body| body.scene().shape == *shape).collect();
                let centres: Vec<Vec3> = of_shape.iter().map(|body| body.centre().as_vec3()).collect();
                let scales: Vec<Vec3> = of_shape.iter().map(|body| Vec3::splat(body.scene().radius as f32)).collect();
                assert_same(&held.vectors("InstancePoses3D:translations"), &centres, &at);
                assert_same(&held.vectors("InstancePoses3D:scales"), &scales, &at);
                let names = held.texts("body");
                assert_eq!(names, of_shape.iter().map(|body| body.name()).collect::<Vec<_>>(), "{at}");
                names.into_iter().for_each(|name| *drawn.entry(name).or_default() += 1);
                let changed = last.replace(held.clone()).is_none_or(|last| last.cells != held.cells);
                let components = ["InstancePoses3D:translations", "InstancePoses3D:scales", "body"];
                assert_eq!(track.logged(step, &components), changed, "{at}");
            }

            let at = format!("{} at step {step}", deforming.entity);
            let held = &deforming.held[frame];
            let (positions, normals) = (held.vectors(POSITIONS), held.vectors(NORMALS));
            let (names, corners, colors) = (held.texts("body"), triangles(held), held.colors("Mesh3D:vertex_colors"));
            assert_eq!((names.len(), colors.len()), (positions.len(), positions.len()), "{at}");
            let (mut first, mut first_triangle) = (0, 0);
            for &index in &deformed {
                let body = world.body(index);
                let vertices = first..first + body.vertex_count();
                let expected: Vec<Vec3> = body.positions().map(|position| position.as_vec3()).collect();
                assert_same(&positions[vertices.clone()], &expected, &format!("{at}: {}", body.name()));
                verify_normals(&body, &normals[vertices.clone()], &at);
                assert!(names[vertices.clone()].iter().all(|name| name == body.name()), "{at}");
                assert!(colors[vertices.clone()].iter().all(|c| *c == color(palette::body(index))), "{at}");
                let count = body.mesh().triangles().len();
                let local = corners[first_triangle..first_triangle + count].iter().map(|t| t.map(|v| v - first as u32));
                assert_eq!(local.collect::<Vec<_>>(), body.mesh().triangles(), "{at}");
                *drawn.entry(body.name().to_owned()).or_default() += 1;
                (first, first_triangle) = (vertices.end, first_triangle + count);
            }
            assert_eq!((first, first_triangle), (positions.len(), corners.len()), "{at}: nothing else");
            let layout = ["Mesh3D:triangle_indices", "Mesh3D:vertex_colors", "body"];
            assert_eq!(deforming.logged(step, &layout), last_deformed != deformed, "{at}");
            let surface = (positions, normals);
            assert_eq!(deforming.logged(step, &[POSITIONS, NORMALS]), last_surface != surface, "{at}");
            (last_deformed, last_surface) = (deformed, surface);

            let bodies: BTreeMap<String, u32> = self.scene.bodies.iter().map(|body| (body.name.clone(), 1)).collect();
            assert_eq!(drawn, bodies, "every body is drawn once at step {step}");
        });
    }

    /// Verifies the influence spheres, each coloured by its body's deepest phase with any body within reach.
    fn verify_spheres(&self) {
        const CENTERS: &str = "Ellipsoids3D:centers";
        const COLORS: &str = "Ellipsoids3D:colors";
        let track = self.track("/world/influence");
        let fixed = self.recording.fixed("/world/influence");
        let radii = self.scene.bodies.iter().map(|body| body.reach * body.radius);
        let half_sizes: Vec<Vec3> = radii.map(|radius| Vec3::splat(radius as f32)).collect();
        let names: Vec<&str> = self.scene.bodies.iter().map(|body| body.name.as_str()).collect();
        assert_eq!(fixed.texts("Ellipsoids3D:labels"), names);

        let idle = if self.scene.bodies.len() > 3 { palette::IDLE_SPHERE_OF_MANY } else { palette::IDLE_SPHERE };
        let mut last = (Vec::new(), Vec::new());
        self.walk_frames(|frame, world| {
            let step = world.steps_taken();
            let centres: Vec<Vec3> = world.bodies().map(|body| body.centre().as_vec3()).collect();
            let of_body = |i: usize| {
                let phases: Vec<Phase> =
                    world.pairs().filter(|pair| pair.a == i || pair.b == i).map(|pair| pair.phase).collect();
                let deepest = [Phase::Core, Phase::Merged, Phase::Apart].into_iter().find(|p| phases.contains(p));
                color(deepest.map_or(idle, phase_color))
            };
            let colors: Vec<Rgba32> = (0..world.body_count()).map(of_body).collect();
            let held = &track.held[frame];
            assert_same(&held.vectors(CENTERS), &centres, &format!("centres at step {step}"));
            assert_same(&held.vectors("Ellipsoids3D:half_sizes"), &half_sizes, &format!("radii at step {step}"));
            assert_same(&held.colors(COLORS), &colors, &format!("colours at step {step}"));
            assert_eq!(track.logged(step, &[CENTERS]), last.0 != centres, "centres at step {step}");
            assert_eq!(track.logged(step, &[COLORS]), last.1 != colors, "colours at step {step}");
            last = (centres, colors);
        });
    }

    /// Verifies that in a batch, the influence spheres of bodies within reach of another are part of the pairs' entity.
    fn verify_reaching_spheres(&self) {
        let track = self.track("/world/pairs");
        self.walk_frames(|frame, world| {
            let mut spheres: BTreeMap<usize, Phase> = BTreeMap::new();
            for pair in world.pairs().filter(|_| self.settings.entities == Entities::Batch) {
                for body in [pair.a, pair.b] {
                    let deepest = spheres.entry(body).or_insert(pair.phase);
                    let depth = |phase| [Phase::Apart, Phase::Merged, Phase::Core].iter().position(|&p| p == phase);
                    *deepest = if depth(pair.phase) > depth(*deepest) { pair.phase } else { *deepest };
                }
            }
            let held = &track.held[frame];
            let step = format!("step {}", world.steps_taken());
            let centres: Vec<Vec3> = spheres.keys().map(|&i| world.body(i).centre().as_vec3()).collect();
            assert_same(&held.vectors("Ellipsoids3D:centers"), &centres, &step);
            let half_size = |i: usize| Vec3::splat(self.scene.bodies[i].sphere_radius() as f32);
            let half_sizes: Vec<Vec3> = spheres.keys().map(|&i| half_size(i)).collect();
            assert_same(&held.vectors("Ellipsoids3D:half_sizes"), &half_sizes, &step);
            let colors: Vec<Rgba32> = spheres.values().map(|&phase| color(phase_color(phase))).collect();
            assert_same(&held.colors("Ellipsoids3D:colors"), &colors, &step);
        });
    }

    /// Verifies that exactly the vertices on which a force acts have arrows.
    fn verify_forces(&self) {
        const ORIGINS: &str = "Arrows3D:origins";
        const VECTORS: &str = "Arrows3D:vectors";
        let scale = arrow_scale(&self.scene);
        let tracks = CAUSES.map(|cause| self.track(&format!("/world/forces/{cause}")));
        let mut last = CAUSES.map(|_| (Vec::new(), Vec::new()));
        let mut forces = BodyForces::default();
        self.walk_frames(|frame, world| {
            let mut arrows = CAUSES.map(|_| (Vec::new(), Vec::new()));
            for (index, body) in world.bodies().enumerate() {
                world.forces(index, &mut forces);
                for (cause, (origins, vectors)) in Cause::of(&self.scene).zip(&mut arrows) {
                    let scale = term(&self.scene, cause).arrow_scale.unwrap_or(scale);
                    for (vertex, force) in forces.of(cause).iter().enumerate() {
                        // a force that vanishes in single precision has no arrow
                        let vector = (scale * force).as_vec3();
                        if vector != Vec3::ZERO {
                            origins.push(body.position(vertex).as_vec3());
                            vectors.push(vector);
                        }
                    }
                }
            }
            for ((track, arrows), last) in tracks.iter().zip(arrows).zip(&mut last) {
                let at = format!("{} at step {}", track.entity, world.steps_taken());
                let held = &track.held[frame];
                assert_same(&held.vectors(ORIGINS), &arrows.0, &at);
                assert_same(&held.vectors(VECTORS), &arrows.1, &at);
                assert_eq!(track.logged(world.steps_taken(), &[ORIGINS, VECTORS]), *last != arrows, "{at}");
                *last = arrows;
            }
        });
    }

    /// Verifies the mean force on each body by each cause, and the largest on any, from the first frame in which it acts.
    fn verify_body_forces(&self) {
        let count = self.scene.bodies.len();
        // the last ones are of any body
        let mut lines = vec![CAUSES.map(|_| BTreeMap::new()); count + 1];
        let mut forces = BodyForces::default();
        self.walk_frames(|_, world| {
            let mut strongest = [0.0_f64; CAUSES.len()];
            let insert = |line: &mut BTreeMap<u64, f64>, mean: f64| {
                if mean > 0.0 || !line.is_empty() {
                    line.insert(world.steps_taken(), mean);
                }
            };
            for (index, lines) in lines[..count].iter_mut().enumerate() {
                world.forces(index, &mut forces);
                for ((cause, line), strongest) in Cause::of(&self.scene).zip(lines).zip(&mut strongest) {
                    let mean = mean_acceleration(world, index, forces.of(cause)).length();
                    *strongest = strongest.max(mean);
                    insert(line, mean);
                }
            }
            lines[count].iter_mut().zip(strongest).for_each(|(line, strongest)| insert(line, strongest));
        });
        let of_any = (lines.pop(), "/strongest".to_owned());
        let of_bodies = lines.into_iter().zip(self.scene.bodies.iter().map(|body| format!("/forces/{}", body.name)));
        let of_bodies = of_bodies.filter(|_| count <= 16);
        let of_any = of_any.0.map(|lines| (lines, of_any.1)).filter(|_| count > 3);
        let plotted: Vec<_> = of_bodies.chain(of_any).collect();
        for family in ["/forces/", "/strongest/"] {
            let is_expected = plotted.iter().any(|(_, of)| format!("{of}/").starts_with(family));
            let entities = self.recording.entities();
            let is_there = entities.iter().any(|path| path.to_string().starts_with(family));
            assert!(is_expected || !is_there, "{family}");
        }
        for (lines, of) in plotted {
            for (cause, values) in CAUSES.iter().zip(lines) {
                let entity = format!("{of}/{cause}");
                assert_eq!(self.recording.entities().contains(&EntityPath::from(entity.as_str())), !values.is_empty());
                if values.is_empty() {
                    continue;
                }
                let track = self.track(&entity);
                for (frame, step) in self.frames().iter().enumerate() {
                    let (logged, expected) = (track.held[frame].scalar(), values.get(step));
                    assert_eq!(logged.is_some(), expected.is_some(), "{entity} at step {step}");
                    let error = logged.zip(expected).map_or(0.0, |(logged, expected)| (logged - expected).abs());
                    assert!(error <= 1e-12 * expected.copied().unwrap_or(0.0), "{entity} at step {step}: {error}");
                }
            }
        }
    }

    /// Verifies the arrows of the mean force on each body by each cause, all on one scale, and the label of the strongest.
    fn verify_resultants(&self) {
        let (track, labels) = (self.track("/world/resultants"), self.track("/world/resultants/labels"));
        let ranking = self.track("/ranking/forces");
        let largest = self.scene.bodies.iter().map(|body| body.radius).fold(0.0, f64::max);
        let (mut forces, framed) = (BodyForces::default(), self.framed());
        let across = width(&framed);
        self.walk_frames(|frame, world| {
            let at = format!("step {}", world.steps_taken());
            let mut expected: Vec<(usize, &str, DVec3, DVec3)> = Vec::new();
            for (index, body) in world.bodies().enumerate() {
                world.forces(index, &mut forces);
                for cause in Cause::of(&self.scene) {
                    let mean = mean_acceleration(world, index, forces.of(cause));
                    expected.extend((mean != DVec3::ZERO).then_some((index, cause.name(), body.centre(), mean)));
                }
            }
            let bodies: Vec<_> = world.bodies().enumerate().collect();
            let longest = expected.iter().map(|(.., mean)| mean.length()).fold(0.0, f64::max);
            let mean_radius = |of: &(usize, &str, DVec3, DVec3)| (self.scene.bodies[of.0].radius * largest).sqrt();
            let most = if bodies.len() > 8 { 3.0 } else { 1.5 };
            let limit = |of: &(usize, &str, DVec3, DVec3)| most * mean_radius(of) / of.3.length();
            let scale = if longest > 0.0 { expected.iter().map(limit).fold(f64::INFINITY, f64::min) } else { 0.0 };
            // weaker ones on the same body are left out, and shorter ones would be specks
            let strongest_of =
                |body: usize| expected.iter().filter(|of| of.0 == body).map(|of| of.3.length()).fold(0.0, f64::max);
            let is_drawn = |of: &&(usize, &str, DVec3, DVec3)| {
                of.3.length() > 0.1 * strongest_of(of.0) && scale * of.3.length() > 0.03 * most * mean_radius(of)
            };
            let drawn = || expected.iter().filter(is_drawn);
            let held = &track.held[frame];
            // a net force starts beside the centre
            let look = Look::new(world, &framed);
            let beside = |(index, cause, centre, mean): &(usize, &str, DVec3, DVec3)| {
                let radius = self.scene.bodies[*index].radius;
                let aside = mean.cross(look.axes[2]).normalize_or_zero();
                *centre + if *cause == "net" { 0.12 * radius * aside } else { DVec3::ZERO }
            };
            let origins = held.vectors("Arrows3D:origins");
            assert_eq!(origins.len(), drawn().count(), "{at}");
            for (found, expected) in origins.iter().zip(drawn().map(beside)) {
                assert!(found.as_dvec3().distance(expected) < 1e-6 * across, "{at}: {found}, {expected}");
            }
            for (found, (.., mean)) in held.vectors("Arrows3D:vectors").iter().zip(drawn()) {
                let error = found.as_dvec3().distance(scale * mean);
                assert!(error <= 3e-7 * largest, "{at}: {found} is not {mean} over {longest}");
            }
            let strongest_on = |index: usize| {
                let of_body = expected.iter().filter(|(body, cause, ..)| *body == index && *cause != "net");
                of_body.map(|(.., mean)| mean.length()).fold(0.0, f64::max)
            };
            let net_on = |index: usize| {
                let net = expected.iter().find(|(body, cause, ..)| *body == index && *cause == "net");
                net.map_or(0.0, |(.., mean)| mean.length())
            };
            // of few bodies all causes are listed, of more the net force on each
            let limit = 0.04 * longest;
            let is_listed = |&index: &usize| strongest_on(index).max(net_on(index)) > limit;
            let mut listed: Vec<f64> = match bodies.len() > 3 {
                true => (0..bodies.len()).filter(is_listed).map(net_on).collect(),
                false => expected.iter().map(|(.., mean)| mean.length()).filter(|&strength| strength > limit).collect(),
            };
            listed.sort_by(|one, other| other.total_cmp(one));
            let rows = ranking.held[frame].texts("Points2D:labels");
            assert_eq!(rows.len(), 8, "{at}");
            let none = listed.is_empty().then_some("no force acts on any body");
            assert!(none.is_none_or(|none| rows[0] == none), "{at}: {}", rows[0]);
            for (number, row) in rows.iter().enumerate().skip(usize::from(none.is_some())) {
                let strength = listed.get(number).copied();
                // NAME: net NUMBER, CAUSE NUMBER, or NAME: CAUSE NUMBER
                let value = if bodies.len() > 3 { row.split(',').next() } else { Some(row.as_str()) };
                let found = value.and_then(|value| value.rsplit(' ').next()).filter(|_| !row.is_empty());
                let found = found.map(|number| number.parse::<f64>().expect("a number"));
                assert_eq!(found.is_some(), strength.is_some(), "{at}: {row}, {strength:?}");
                let error = found.zip(strength).map_or(0.0, |(found, strength)| (found - strength).abs());
                assert!(error <= 6e-3 * strength.unwrap_or(0.0).max(1e-9), "{at}: {row}, but {strength:?}");
            }
            let acting: Vec<usize> = (0..bodies.len()).filter(|&index| strongest_on(index) > 0.0).collect();
            let text_of = |index: usize| {
                let of_body = expected.iter().filter(|(body, cause, ..)| *body == index && *cause != "net");
                let strongest = of_body.max_by(|one, other| one.3.length().total_cmp(&other.3.length()));
                let (_, cause, _, mean) = strongest.expect("a force");
                let name = &self.scene.bodies[index].name;
                // of more, the numbers are in the ranking
                match bodies.len() > 3 {
                    true => name.clone(),
                    false => {
                        format!("{name}: net {}, {cause} {}", significant(net_on(index)), significant(mean.length()))
                    }
                }
            };
            let is_strong = |index: usize| {
                let stronger = acting.iter().filter(|&&other| net_on(other) > net_on(index)).count();
                acting.contains(&index) && stronger < 5
            };
            let held = &labels.held[frame];
            let (mut labelled, mut all) = (Vec::new(), Vec::new());
            for (label, place) in held.texts("Points3D:labels").iter().zip(held.vectors("Points3D:positions")) {
                let of = bodies.iter().find(|(_, body)| body.scene().name == label.split(':').next().unwrap_or(label));
                let index = of.expect("its body").0;
                all.push((index, place.as_dvec3(), label.len()));
                if label.contains(':') || (bodies.len() > 3 && is_strong(index) && labelled.len() < 5) {
                    assert_eq!(*label, text_of(index), "{at}");
                    labelled.push(index);
                }
            }
            look.assert_readable_through(3, &all, &at); // bodies are translucent
            let has_room = |index: usize| {
                let stronger = |of: &&(usize, DVec3, usize)| net_on(of.0) >= (1.0 - 1e-12) * net_on(index);
                let before: Vec<_> =
                    all.iter().filter(|of| labelled.contains(&of.0)).filter(stronger).copied().collect();
                look.has_room(index, text_of(index).len(), &before)
            };
            assert_labelled(&labelled, &acting, net_on, 1e-9 * longest, has_room, &at);
            // the names of others, as far as there is room
            for index in (0..bodies.len()).filter(|&index| bodies.len() <= 8 && all.iter().all(|of| of.0 != index)) {
                assert!(!look.has_room(index, self.scene.bodies[index].name.len(), &all), "{at}: {index}");
            }
        });
    }

    /// The entities of the lines of the largest displacements.
    fn displacement_lines(&self) -> Vec<String> {
        let bodies = if self.scene.bodies.len() <= 16 { self.scene.bodies.as_slice() } else { &[] };
        bodies.iter().map(|body| format!("/displacement/{}", body.name)).collect()
    }

    /// Verifies the mark of the vertex with the largest displacement outside all other bodies, its label above them, and
    /// the number at the end of the colours.
    fn verify_largest(&self) {
        let (track, scale) = (self.track("/largest"), self.track("/legend/ticks"));
        let of_bodies = self.track("/largest/bodies");
        let ranking = (self.scene.bodies.len() > 3).then(|| self.track("/ranking/displacements"));
        let lines: Vec<_> = self.displacement_lines().iter().map(|line| self.track(line)).collect();
        let framed = self.framed();
        self.walk_frames(|frame, world| {
            // whether a vertex lies in another body, by winding number; for the colours, of one not merged within 0.95 of the radius
            let positions: Vec<Vec<DVec3>> = world.bodies().map(|body| body.positions().collect()).collect();
            let groups = groups(world);
            let is_inside = |at: DVec3, index: usize, exactly: bool| {
                world.bodies().enumerate().filter(|(other, _)| *other != index).any(|(other, body)| {
                    let distance = body.centre().distance(at) / body.scene().radius;
                    match exactly || groups[other] == groups[index] {
                        true => {
                            let farthest = 1.0 + body.max_displacement() / body.scene().radius;
                            distance < farthest && winding_number(&positions[other], body.mesh().triangles(), at) > 0.5
                        }
                        false => distance < 0.95,
                    }
                })
            };
            let (mut largest, mut of_all): (Option<(f64, DVec3, String)>, f64) = (None, 0.0);
            let (mut on_surface, mut top) = (vec![], f64::NEG_INFINITY);
            let is_counted = frame % 10 == 0; // a winding number takes long
            for (index, body) in world.bodies().enumerate() {
                top = top.max(body.centre().z + body.scene().radius);
                for (vertex, &position) in positions[index].iter().enumerate() {
                    let displacement = body.displacement(vertex).length() / body.scene().radius;
                    of_all = of_all.max(displacement);
                    let is_larger = displacement > largest.as_ref().map_or(0.0, |(largest, ..)| *largest);
                    if is_counted && body.max_displacement() > 0.0 && !is_inside(position, index, false) {
                        on_surface.push((displacement, position, body.centre()));
                    }
                    if is_larger && !is_inside(position, index, true) {
                        let name = &body.scene().name;
                        let label = format!("largest on the surface: {name}:{vertex}, {displacement:.3} R");
                        largest = Some((displacement, position, label));
                    }
                }
            }
            let largest_of = |body: &BodyView<'_>| {
                let lengths = (0..body.vertex_count()).map(|vertex| body.displacement(vertex).length());
                lengths.fold(0.0, f64::max) / body.scene().radius
            };
            let mut ranked: Vec<(f64, String)> =
                world.bodies().map(|body| (largest_of(&body), body.scene().name.clone())).collect();
            for (line, (largest, name)) in lines.iter().zip(&ranked) {
                let error = (line.held[frame].scalar().expect("a value") - largest).abs();
                assert!(error <= 1e-12 * largest, "step {}: {name} {error}", world.steps_taken());
            }
            ranked.sort_by(|one, other| other.0.total_cmp(&one.0));
            // what would read 0.000 is left out
            let least = if ranked[0].0 > 1e-3 { 5e-4 } else { 1e-9 * ranked[0].0 };
            if let Some(ranking) = &ranking {
                let rows = ranking.held[frame].texts("Points2D:labels");
                assert_eq!(rows.len(), 8, "step {}", world.steps_taken());
                for (row, (largest, name)) in rows.iter().zip(&ranked) {
                    let row = row.strip_suffix(", inside a body").unwrap_or(row);
                    let is_right = match *largest > least {
                        true => row.starts_with(&format!("{name}:")) && row.ends_with(&format!(" {largest:.3} R")),
                        false => ["", "no vertex is displaced"].contains(&row),
                    };
                    assert!(is_right, "step {}: {row}, but {name} {largest}", world.steps_taken());
                }
            }
            let at = format!("step {}", world.steps_taken());
            let labels = of_bodies.held[frame].texts("Points3D:labels");
            let label_of = |index: usize| {
                let (name, largest) = (&self.scene.bodies[index].name, largest_of(&world.body(index)));
                let (label, inside) =
                    (format!("{name} {largest:.3} R"), format!("{name} {largest:.3} R, inside a body"));
                match largest > least {
                    false => name.clone(),
                    true if labels.contains(&inside) => inside,
                    true => label,
                }
            };
            let mut all: Vec<usize> = (0..self.scene.bodies.len()).collect();
            all.sort_by(|&one, &other| largest_of(&world.body(other)).total_cmp(&largest_of(&world.body(one))));
            let labelled: Vec<usize> = all.iter().copied().filter(|&index| labels.contains(&label_of(index))).collect();
            let is_name = |label: &&String| {
                let of = all.iter().find(|index| self.scene.bodies[**index].name == **label);
                of.is_some_and(|index| !labelled.contains(index))
            };
            let named = labels.iter().filter(is_name).count();
            assert_eq!(labelled.len() + named, labels.len(), "{at}: {labels:?}");
            let labelled: Vec<usize> =
                labelled.into_iter().filter(|body| all[..all.len().min(5)].contains(body)).collect();
            let places = of_bodies.held[frame].vectors("Points3D:positions");
            let of = |label: &String| {
                let is_of = |index: &usize| [&self.scene.bodies[*index].name, &label_of(*index)].contains(&label);
                (0..self.scene.bodies.len()).find(is_of).expect("its body")
            };
            let shown: Vec<_> =
                labels.iter().zip(&places).map(|(label, place)| (of(label), place.as_dvec3(), label.len())).collect();
            let look = Look::new(world, &framed);
            look.assert_readable(&shown, &at);
            // the label of the mark, and the vertex that it marks
            let mark = &track.held[frame];
            let label = mark.texts("Points3D:labels").concat();
            let longest = label.lines().map(|line| line.chars().count()).max().unwrap_or(0);
            let places = mark.vectors("Points3D:positions");
            let mut of_mark: Vec<_> = places.iter().map(|place| (usize::MAX, place.as_dvec3(), 0)).collect();
            // its lines hang below its place
            if let Some((.., first, _)) = of_mark.pop() {
                let line = 0.07 * (look.eye - first).dot(look.axes[2]) * look.axes[1];
                let lines = (0..label.lines().count()).map(|number| first - number as f64 * line);
                of_mark.extend(lines.map(|place| (usize::MAX, place, longest)));
            }
            let has_room = |index: usize| {
                let largest = |of: usize| largest_of(&world.body(of));
                let larger = |of: &&(usize, DVec3, usize)| largest(of.0) >= (1.0 - 1e-12) * largest(index);
                let before = shown.iter().filter(|of| labelled.contains(&of.0)).filter(larger).copied();
                let before: Vec<_> = before.chain(of_mark.iter().copied()).collect();
                look.has_room(index, label_of(index).len(), &before)
            };
            assert_labelled(&labelled, &all, |index| largest_of(&world.body(index)), least, has_room, &at);
            for &index in labelled.iter().filter(|_| frame % 10 == 0) {
                let body = world.body(index);
                let most = (0..body.vertex_count()).max_by(|&one, &other| {
                    let length = |vertex: usize| body.displacement(vertex).length();
                    length(one).total_cmp(&length(other)).then(other.cmp(&one))
                });
                let is_said = label_of(index).ends_with(", inside a body");
                // of more than three bodies, the ranking says it
                let is_expected =
                    self.scene.bodies.len() <= 3 && is_inside(positions[index][most.expect("a vertex")], index, true);
                assert_eq!(is_said, is_expected, "{at}: {labels:?}");
            }
            if let Some((displacement, position, label)) = largest {
                let held = &track.held[frame];
                let logged = held.texts("Points3D:labels").concat();
                let (outside, hidden) = logged.split_once("\ninside another body: ").unwrap_or((&logged, ""));
                let of_front = outside.strip_prefix("largest in front: ").and_then(|front| front.split_once('\n'));
                let (front, outside) = of_front.unwrap_or(("", outside));
                let in_view = outside.strip_suffix(", not in view");
                // whether a vertex faces the eye, and nothing is in front of it, by more than `margin`
                let is_clear = |index: usize, vertex: usize, margin: f64| {
                    let place = positions[index][vertex];
                    let to_eye = (look.eye - place).normalize();
                    let triangles_of = |body: usize| world.body(body).mesh().triangles().to_vec();
                    let is_facing = area_normals(&positions[index], &triangles_of(index))[vertex].dot(to_eye) > margin;
                    let side = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| (b - a).cross(c - a).dot(d - a) > 0.0;
                    let is_behind = |body: usize, corners: &[u32; 3]| {
                        let [a, b, c] = corners.map(|corner| positions[body][corner as usize]);
                        let around = [(a, b), (b, c), (c, a)].map(|(from, to)| side(place, look.eye, from, to));
                        !(body == index && corners.contains(&(vertex as u32)))
                            && side(a, b, c, place) != side(a, b, c, look.eye)
                            && around.iter().all(|one| *one == around[0])
                    };
                    // of many bodies, none hides a place
                    let all = if positions.len() > 64 { index..index + 1 } else { 0..positions.len() };
                    let hides = |body: usize| triangles_of(body).iter().any(|corners| is_behind(body, corners));
                    // a body with deeper dents than that is taken for whole
                    is_facing && !look.is_hidden(index, place, 0.15) && !all.into_iter().any(hides)
                };
                let named = |text: &str| {
                    let (name, vertex) = text.split_once(':').expect("a vertex");
                    let index = world.bodies().position(|body| body.scene().name == name).expect("a body");
                    (index, vertex.parse::<usize>().expect("a number"))
                };
                let own = outside.strip_prefix("largest on the surface: ").unwrap_or("");
                if in_view.is_some() {
                    let (index, vertex) = named(own.split_once(", ").expect("a length").0);
                    let is_at_rim = look.is_at_rim(index, positions[index][vertex]);
                    assert!(is_at_rim || !is_clear(index, vertex, 0.001), "{at}: {logged}");
                }
                let own = if in_view.is_some() { "" } else { own };
                let marked = match (if front.is_empty() { own } else { front }).split_once(", ") {
                    Some((vertex, length)) => {
                        let (index, vertex) = named(vertex);
                        let body = world.body(index);
                        let displacement = body.displacement(vertex).length() / body.scene().radius;
                        assert_eq!(length, format!("{displacement:.3} R"));
                        let place = positions[index][vertex];
                        assert!(is_clear(index, vertex, -0.001), "{at}: {logged}");
                        place
                    }
                    None => position,
                };
                assert_eq!(in_view.unwrap_or(outside), label, "step {}", world.steps_taken());
                let is_complete = of_all == displacement || hidden.ends_with(&format!(", {of_all:.3} R"));
                assert!(is_complete, "step {}: {logged}, but {of_all}", world.steps_taken());
                let ends = held.vectors("Points3D:positions");
                let from = if in_view.is_some() { ends[1] } else { marked.as_vec3() };
                assert_eq!((ends.len(), ends[0]), (2, from), "step {}", world.steps_taken());
                let [from, to] = [ends[0], ends[1]].map(|end| end.as_dvec3());
                // seen from a place twice as far as the eye, the label stands above the vertex and all bodies, perhaps closer to it
                let far = look.eye + look.distance * look.axes[2];
                let [away, of_vertex] = [to, from].map(|end| (end - far).truncate());
                let share = if in_view.is_some() { 1.0 } else { away.length() / of_vertex.length() };
                let seen = far + (to - far) / share;
                let is_above = seen.z > top.max(from.z) || in_view.is_some();
                let is_aside = seen.truncate().distance(from.truncate());
                assert!(
                    is_above && is_aside < 1e-5 * look.distance && (0.79..1.001).contains(&share),
                    "{ends:?}, {top}"
                );
                if !is_counted {
                    return;
                }
                let [.., end] = &scale.held[frame].texts("Points2D:labels")[..] else { panic!("no numbers") };
                // the colours end at the largest on the sides that face the eye, but for spikes, at a round number
                let facing = on_surface.iter().filter(|(_, at, centre)| (at - centre).dot(look.eye - centre) > 0.0);
                let facing: Vec<f64> = facing.map(|(displacement, ..)| *displacement).collect();
                let in_front = facing.iter().copied().fold(0.0, f64::max);
                let number = end.split(';').next().expect("a number").parse::<f64>().expect("a number");
                let above = facing.iter().filter(|displacement| **displacement > 1.01 * number).count();
                assert!(50 * above <= facing.len() + 50, "{number}: {above} of {} are above", facing.len());
                let is_fit = number >= 0.495 * in_front && number <= f64::max(0.01, 1.51 * in_front);
                assert!(is_fit, "{number} is no end for {in_front}");
                let (end, beyond) =
                    end.split_once("; up to ").map_or((end.as_str(), None), |(end, at)| (end, Some(at)));
                let beyond = beyond.map(|text| text.split_once(" on the surface, at ").expect("a vertex"));
                assert!(
                    beyond.is_none_or(|(_, vertex)| label.contains(&format!(": {vertex}, "))),
                    "{beyond:?}, {label}"
                );
                let beyond = beyond.map(|(text, _)| text.parse::<f64>().expect("a number"));
                assert_eq!(beyond.is_some(), displacement > 1.001 * number, "{end}, but {displacement}");
                let error = beyond.map_or(0.0, |beyond| (beyond - displacement).abs() / displacement);
                assert!(error <= 6e-3, "{beyond:?}, but {displacement}");
            }
        });
    }

    /// Verifies the volume of the bodies one by one, which is that of all surfaces while no bodies share one.
    fn verify_volume(&self) {
        if !(2..=64).contains(&self.scene.bodies.len()) {
            return;
        }
        let tracks = ["surfaces", "bodies"].map(|of| self.track(&format!("/volume/{of}")));
        self.walk_frames(|frame, world| {
            let volume = |body: BodyView<'_>| {
                let mesh = body.scene().shape.mesh();
                let six_times = mesh.triangles().iter().map(|corners| {
                    let [a, b, c] = corners.map(|corner| body.position(corner as usize) - body.centre());
                    DMat3::from_cols(a, b, c).determinant()
                });
                six_times.sum::<f64>() / 6.0
            };
            let expected: f64 = world.bodies().map(volume).sum();
            let [surfaces, bodies] = tracks.each_ref().map(|track| track.held[frame].scalar().expect("a volume"));
            assert!((bodies - expected).abs() <= 1e-12 * expected, "step {}: {bodies}", world.steps_taken());
            if world.pairs().all(|pair| pair.phase == Phase::Apart) {
                assert_eq!(surfaces, bodies, "step {}", world.steps_taken());
            }
        });
    }

    /// Verifies that the energies listed are those plotted, but for those that were always 0.
    fn verify_energies(&self) {
        let ranking = self.track("/ranking/energies/0");
        let lines = [("vibration", "energy_vibration"), ("elastic", "energy_elastic")];
        let lines = lines.map(|(label, of)| (label, self.track(&format!("/diagnostics/{of}")), false));
        let mut lines = Vec::from(lines);
        self.walk_frames(|frame, world| {
            let at = format!("step {}", world.steps_taken());
            let rows = ranking.held[frame].texts("Points2D:labels");
            let mut rows = rows.iter().filter(|row| !row.is_empty());
            for (label, track, has_occurred) in &mut lines {
                let value = track.held[frame].scalar().expect("a number");
                *has_occurred |= value != 0.0;
                if !*has_occurred {
                    continue;
                }
                let (name, number) = rows.next().and_then(|row| row.split_once(' ')).expect("a row");
                let number: f64 = number.parse().expect("a number");
                assert!(name == *label && (number - value).abs() <= 1e-3 * value.abs(), "{at}: {number}, {value}");
            }
            let rest: Vec<_> = rows.collect();
            assert!(rest.is_empty() || rest == ["all are 0"], "{at}: {rest:?}");
        });
    }

    /// Verifies that the groups of more than a few bodies are listed with their volumes, and how these differ from those of
    /// their bodies.
    fn verify_groups(&self) {
        if self.scene.bodies.len() <= 3 {
            return;
        }
        let ranking = self.track("/ranking/groups");
        let has_volume = self.scene.bodies.len() <= 64;
        let volumes = has_volume.then(|| ["surfaces", "bodies"].map(|of| self.track(&format!("/volume/{of}"))));
        self.walk_frames(|frame, world| {
            let at = format!("step {}", world.steps_taken());
            let mut expected: BTreeMap<usize, Vec<&str>> = BTreeMap::new();
            for (group, body) in groups(world).into_iter().zip(&self.scene.bodies) {
                expected.entry(group).or_default().push(&body.name);
            }
            // as many as fit into the room, at least one
            let listed = |names: &Vec<&str>, room: usize| {
                let most = (1..=names.len()).rev().find(|&most| most == 1 || names[..most].join("+").len() <= room);
                let (first, others) = names.split_at(most.expect("a name"));
                let more = if others.is_empty() { String::new() } else { format!("+{}", others.len()) };
                first.join("+") + &more
            };
            // bodies that are in no group have rows of their own, while there are groups
            let is_any_joined = expected.values().any(|names| names.len() > 1);
            let has_row = |names: &Vec<&str>| names.len() > 1 || (is_any_joined && has_volume);
            let expected: Vec<Vec<&str>> = expected.into_values().filter(has_row).collect();
            let rows = ranking.held[frame].texts("Points2D:labels");
            let rows: Vec<(&str, &str)> = rows.iter().filter_map(|row| row.split_once(": ")).collect();
            assert_eq!(rows.len(), expected.len().min(8), "{at}");
            let mut lost = 0.0;
            for (names, what) in &rows {
                let numbers = what.split_once(" pieces, ").map_or(*what, |(_, numbers)| numbers);
                // with the number of pieces, 20 characters
                let room = 20 - (what.len() - numbers.len());
                assert!(expected.iter().any(|group| listed(group, room) == *names), "{at}: {names}");
                let (volume, bodies) = numbers.split_once(" (bodies ").unwrap_or((numbers, numbers));
                let [volume, bodies] =
                    [volume, bodies.trim_end_matches(')')].map(|number| number.parse::<f64>().expect("a volume"));
                lost += bodies - volume;
            }
            if let Some(tracks) = volumes.as_ref().filter(|_| rows.len() < 8) {
                let [surfaces, bodies] = tracks.each_ref().map(|track| track.held[frame].scalar().expect("a volume"));
                assert!((bodies - surfaces - lost).abs() <= 1e-3 * bodies, "{at}: {lost}");
            }
        });
    }

    /// Verifies the values of each vertex: its displacement, the force on it, the influence that reaches it.
    fn verify_vertices(&self) {
        if self.settings.entities == Entities::Batch {
            return;
        }
        let scale = self.track("/legend/ticks");
        let ends: Vec<f32> = scale
            .held
            .iter()
            .map(|row| {
                let labels = row.texts("Points2D:labels");
                labels.last().and_then(|end| end.split(';').next()?.parse().ok()).expect("a number")
            })
            .collect();
        for (index, scene) in self.scene.bodies.iter().enumerate() {
            let track = self.track(&format!("/world/bodies/{}/surface", scene.name));
            let fixed = self.recording.fixed(&track.entity);
            assert_eq!(fixed.texts("body"), [scene.name.as_str()]);
            assert_eq!(fixed.cells["vertex"].len() as u64, scene.shape.vertex_count());
            let mut forces = BodyForces::default();
            self.walk_frames(|frame, world| {
                let (body, held) = (world.body(index), &track.held[frame]);
                world.forces(index, &mut forces);
                let displacement = held.get::<sdk::datatypes::Float32>("displacement_in_radii");
                let net = held.get::<sdk::datatypes::Float32>("net_force");
                let reach = held.texts("reach");
                let heat = held.get::<sdk::datatypes::Vec2D>("heat_texcoords");
                assert_eq!((displacement.len(), net.len(), reach.len()), (body.vertex_count(), net.len(), net.len()));
                for i in 0..body.vertex_count() {
                    let at = format!("{}, vertex {i} at step {}", track.entity, world.steps_taken());
                    let expected = (body.displacement(i).length() / scene.radius) as f32;
                    assert!((displacement[i].0 - expected).abs() <= 1e-6 * expected.max(1e-30), "{at}");
                    assert_eq!(net[i].0, forces.of(Cause::Net).get(i).length() as f32, "{at}");
                    // half of the texture is the colours, from no displacement to the end of the scale
                    let [place, _] = heat[i].0;
                    let end: f32 = ends[frame];
                    assert!((place - 0.5 * (expected / end).min(1.0)).abs() <= 4e-3, "{at}: {place}");
                    let felt = [Cause::Attraction, Cause::Repulsion, Cause::Core]
                        .map(|cause| forces.of(cause).get(i) != DVec3::ZERO);
                    let word = match felt {
                        [_, _, true] => "in a core",
                        [true, true, _] => "attracted and repelled",
                        [true, ..] => "attracted",
                        [_, true, _] => "repelled",
                        _ => "out of reach",
                    };
                    assert_eq!(reach[i], word, "{at}");
                }
            });
        }
    }

    /// Verifies coloured lines between the centres of the closest pairs within reach: first those without a recent
    /// event, of which the closest have labels.
    fn verify_lines(&self) {
        let (track, recent) = (self.track("/world/pairs"), self.track("/world/recent"));
        let names_track = (2..=32).contains(&self.scene.bodies.len()).then(|| self.track("/world/names"));
        let framed = self.framed();
        self.walk_frames(|frame, world| {
            let at = format!("step {}", world.steps_taken());
            let look = Look::new(world, &framed);
            let named = names_track.iter().map(|track| &track.held[frame]).flat_map(|held| {
                let of =
                    |name: &String| self.scene.bodies.iter().position(|body| body.name == *name).expect("its body");
                let names = held.texts("Points3D:labels").into_iter().zip(held.vectors("Points3D:positions"));
                names.map(|(name, place)| (of(&name), place.as_dvec3(), name.len())).collect::<Vec<_>>()
            });
            let named: Vec<(usize, DVec3, usize)> = named.collect();
            look.assert_readable(&named, &at);
            for index in (0..self.scene.bodies.len())
                .filter(|&index| names_track.is_some() && named.iter().all(|of| of.0 != index))
            {
                assert!(!look.has_room(index, self.scene.bodies[index].name.len(), &named), "{at}: {index}");
            }
            let mut pairs: Vec<_> = world.pairs().collect();
            pairs.sort_by(|x, y| x.q.total_cmp(&y.q));
            pairs.truncate(self.settings.pairs);
            let held = &track.held[frame];
            let highlighted = recent.held.get(frame).map(|held| held.texts("Points3D:labels")).unwrap_or_default();
            let names = |label: &str, pair: &str| {
                label.contains(&format!(" {pair}; ")) || label.contains(&format!(" {pair}, "))
            };
            let is_highlighted = |pair: &PairView| {
                let [a, b] = [pair.a, pair.b].map(|body| &self.scene.bodies[body].name);
                let is_of = |label: &String| {
                    names(label, &format!("{a}~{b}")) && label.ends_with(&format!("; now q = {}", self.told_q(pair.q)))
                };
                highlighted.iter().any(is_of)
            };
            // labels that would cover each other are left out; those of events stand above
            let between = |a: usize, b: usize| 0.5 * (world.body(a).centre() + world.body(b).centre());
            let label = |pair: &PairView| format!("{} q = {}", self.pair_name((pair.a, pair.b)), self.told_q(pair.q));
            let place = |pair: &PairView| (between(pair.a, pair.b), label(pair).len());
            let (mut first, mut rest): (Vec<PairView>, Vec<PairView>) = (vec![], vec![]);
            for pair in pairs {
                let taken = first.iter().map(place).chain(named.iter().map(|&(_, place, length)| (place, length)));
                let is_clear = !taken.into_iter().any(|other| look.covers([other, place(&pair)], 1.0));
                let is_labelled = !is_highlighted(&pair) && is_clear && self.scene.bodies.len() <= 3;
                if is_labelled { first.push(pair) } else { rest.push(pair) }
            }
            let labelled = first.len();
            let pairs = [first, rest].concat();
            let mut labels: Vec<String> = pairs[..labelled].iter().map(label).collect();
            if labelled == 1 && pairs.len() > 1 {
                labels.push(String::new());
            }
            assert_eq!(held.texts("LineStrips3D:labels"), labels, "step {}", world.steps_taken());
            let colors: Vec<Rgba32> = pairs.iter().map(|pair| color(phase_color(pair.phase))).collect();
            assert_eq!(held.colors("LineStrips3D:colors"), colors);
            let strips = held.get::<sdk::components::LineStrip3D>("LineStrips3D:strips");
            for (pair, strip) in pairs.iter().zip(&strips) {
                let ends = [pair.a, pair.b].map(|i| Vec3D(world.body(i).centre().as_vec3().to_array()));
                assert_eq!(strip.0, ends);
            }
            assert_eq!(strips.len(), pairs.len());
        });
    }

    /// Verifies that the highlight changes with every event, at its exact time, and that among many bodies the pair is drawn
    /// alone, about the point midway between them and in units of the larger radius.
    fn verify_recent(&self) {
        let rows = self.recording.rows(&EntityPath::from("/world/recent"));
        for event in self.events() {
            let pair = self.pair_name((event.a as usize, event.b as usize));
            let colon = if event.name().contains(' ') { ":" } else { "" };
            let of_event = format!("{}{colon} {pair}, ", event.name());
            let is_there = rows.iter().any(|(_, row)| {
                (row.step, row.time) == (event.step as i64, nanoseconds(event.time))
                    && row.texts("Points3D:labels").iter().any(|label| label.starts_with(&of_event))
            });
            assert!(is_there, "{of_event} at {}", event.time);
        }
        if self.scene.bodies.len() <= 8 {
            let (track, mut last, mut age) = (self.track("/world/recent"), BTreeMap::new(), 0);
            let mut frame = 0;
            self.walk(|world| {
                let events = &world.report().events;
                if !events.is_empty() {
                    (last, age) = (BTreeMap::new(), 0);
                    last.extend(events.iter().map(|event| ((event.a as usize, event.b as usize), event.name())));
                }
                if !self.is_frame(world) {
                    return;
                }
                age += 1;
                let mut labels = track.held[frame].texts("Points3D:labels");
                frame += 1;
                let named = |((a, b), name): (&(usize, usize), &&str)| {
                    let colon = if name.contains(' ') { ":" } else { "" };
                    let [one, other] = [a, b].map(|&body| world.body(body));
                    let sum = one.scene().radius + other.scene().radius;
                    let q = one.centre().distance(other.centre()) / sum;
                    format!("{name}{colon} {}; now q = {}", self.pair_name((*a, *b)), self.told_q(q))
                };
                let mut expected: Vec<String> = last.iter().filter(|_| age <= 24).map(named).collect();
                labels.sort();
                expected.sort();
                assert!(expected.len() <= 4, "step {}", world.steps_taken());
                assert_eq!(labels, expected, "step {}", world.steps_taken());
            });
            return;
        }
        let (track, mut last) = (self.track("/recent/pair"), None);
        let (mut frame, mut age) = (0, 0);
        self.walk(|world| {
            if let Some(event) = world.report().events.last() {
                (last, age) = (Some([event.a as usize, event.b as usize]), 0);
            }
            if !self.is_frame(world) {
                return;
            }
            age += 1;
            let positions = track.held[frame].vectors("Mesh3D:vertex_positions");
            frame += 1;
            if age >= 24 && age % 8 != 0 {
                return; // drawn more seldom
            }
            let bodies = last.map(|pair| pair.map(|index| world.body(index)));
            let expected: Vec<Vec3> = bodies
                .iter()
                .flatten()
                .flat_map(|body| {
                    let [a, b] = bodies.expect("a pair");
                    let middle = 0.5 * (a.centre() + b.centre());
                    let radius = a.scene().radius.max(b.scene().radius);
                    (0..body.vertex_count()).map(move |i| ((body.position(i) - middle) / radius).as_vec3())
                })
                .collect();
            assert_eq!(positions.len(), expected.len(), "step {}", world.steps_taken());
            let is_near = |(found, expected): (&Vec3, &Vec3)| found.distance(*expected) < 2e-5;
            assert!(positions.iter().zip(&expected).all(is_near), "step {}", world.steps_taken());
        });
    }

    /// Verifies the marks of pairs on paths that came near and stayed apart: each at the smallest q of its pair.
    fn verify_near_misses(&self) {
        let mut joined = BTreeSet::new();
        self.walk(|world| {
            joined.extend(world.pairs().filter(|pair| pair.phase != Phase::Apart).map(|pair| (pair.a, pair.b)))
        });
        joined.extend(self.events().iter().map(|event| (event.a as usize, event.b as usize)));
        let q = |(a, b): (usize, usize), time: f64| {
            let [a, b] = [a, b].map(|body| &self.scene.bodies[body]);
            a.path().unwrap().position(time).distance(b.path().unwrap().position(time)) / (a.radius + b.radius)
        };
        let end = self.steps() as f64 * self.scene.dt;
        let least = |pair| (0..=4096).map(|k| q(pair, end * f64::from(k) / 4096.0)).fold(f64::INFINITY, f64::min);
        // neighbours that do not move, or move apart, are no near misses
        let approaches = |pair| q(pair, 0.0) > least(pair) + 1e-4;
        let is_quiet = |pair: &(usize, usize)| !joined.contains(pair) && approaches(*pair);
        let quiet: Vec<_> = self.pairs().into_iter().filter(is_quiet).collect();
        let marks = self.recording.rows(&EntityPath::from("/marks/q/near_miss"));
        assert_eq!(marks.is_empty(), quiet.is_empty());
        assert!(marks.len() <= 5 && (quiet.len() > 5 || marks.len() == quiet.len()), "{} of {quiet:?}", marks.len());
        let drawn = self.recording.rows(&EntityPath::from("/marks/drawn/near_miss"));
        let is_marked = |time: i64, q: f64| marks.iter().any(|(_, mark)| (mark.time, mark.scalar()) == (time, Some(q)));
        assert!(drawn.iter().all(|(_, mark)| is_marked(mark.time, mark.scalar().expect("q"))));
        for (_, mark) in marks {
            let (time, value) = (mark.time as f64 * 1e-9, mark.scalar().expect("q"));
            let is_of = |pair: &&(usize, usize)| (q(**pair, time) - value).abs() < 1e-6 && value < least(**pair) + 1e-6;
            assert!(quiet.iter().any(|pair| is_of(&pair)), "q = {value} at {time} s");
        }
    }

    /// Verifies distances while within reach, their thresholds, and lanes that change at the exact times.
    fn verify_pairs(&self) {
        let pairs = self.pairs();
        let mut distances = vec![BTreeMap::new(); pairs.len()];
        let mut lanes = vec![Vec::new(); pairs.len()];
        self.walk(|world| {
            for event in &world.report().events {
                let Some(i) = pairs.iter().position(|&pair| pair == (event.a as usize, event.b as usize)) else {
                    continue;
                };
                let mut change = |phase: Phase| {
                    lanes[i].push((event.step as i64, nanoseconds(event.time), phase.name().to_owned()));
                };
                if distances[i].is_empty() {
                    change(event.from);
                }
                change(event.to);
            }
            let (step, now) = (world.steps_taken(), nanoseconds(world.time()));
            // a pair that gets its plot because of an event also shows its distances since it came within reach
            for i in (self.settings.pairs..pairs.len()).filter(|_| self.is_frame(world)) {
                let is_here = world.pairs().any(|pair| (pair.a, pair.b) == pairs[i]);
                if !is_here && lanes[i].len() < 2 {
                    distances[i].clear();
                    lanes[i].clear();
                }
            }
            for pair in world.pairs().filter(|_| self.is_frame(world)) {
                let Some(i) = pairs.iter().position(|&known| known == (pair.a, pair.b)) else { continue };
                distances[i].insert(step, pair.q);
                if lanes[i].is_empty() {
                    lanes[i].push((step as i64, now, pair.phase.name().to_owned()));
                }
            }
        });

        let thresholds = &self.scene.thresholds;
        let levels =
            [("merge_at", thresholds.merge_at), ("split_at", thresholds.split_at), ("core_at", thresholds.core_at)];
        for ((pair, distances), lane) in pairs.into_iter().zip(distances).zip(lanes) {
            let entity = |part: &str| format!("/pairs/{}/{part}", self.pair_name(pair));
            for (part, level) in levels {
                if level > 0.0 {
                    let level = distances.keys().map(|&step| (step, level)).collect();
                    self.verify_line(&entity(part), Line::Threshold, &level);
                }
            }
            self.verify_line(&entity("distance"), Line::Straight, &distances);

            let rows = self.recording.rows(&EntityPath::from(entity("phase")));
            let rows: Vec<_> =
                rows.into_iter().map(|(_, row)| (row.step, row.time, row.text("StateChange:state"))).collect();
            assert_eq!(rows, lane, "{}", entity("phase"));
            let fixed = self.recording.fixed(&entity("phase"));
            assert_eq!(fixed.texts("StateConfiguration:values"), ["apart", "merged", "core"]);
        }
    }

    /// Verifies that each event is logged once, in order, at its exact time and at the step that it affects.
    fn verify_events(&self) {
        let events = self.events();
        let rows = self.recording.rows(&EntityPath::from("/events"));
        assert_eq!(rows.len(), events.len());
        let thresholds = &self.scene.thresholds;
        for (event, (_, row)) in events.iter().zip(rows) {
            let text = row.text("TextLog:text");
            assert_eq!((row.step, row.time), (event.step as i64, nanoseconds(event.time)), "{text}");
            assert_eq!(row.text("TextLog:level"), event.name());
            assert_eq!(row.colors("TextLog:color"), [color(phase_color(event.to))], "{text}");
            let names = [event.a, event.b].map(|body| self.scene.bodies[body as usize].name.as_str());
            assert_eq!(row.texts("bodies"), names);
            assert_eq!(row.texts("phases"), [event.from.name(), event.to.name()]);
            let number = |component| row.get::<Float64>(component)[0].0;
            assert_eq!([number("time"), number("q")], [event.time, event.q], "exactly");
            let pair = self.pair_name((event.a as usize, event.b as usize));
            let colon = if event.name().contains(' ') { ":" } else { "" };
            for part in [
                format!("{}{colon} {pair} ", event.name()),
                format!("t = {:.9} s", event.time),
                format!("q = {:.6}", event.q),
                format!("step {}", event.step),
            ] {
                assert!(text.contains(&part), "{text}: {part}");
            }

            // on the paths themselves: within the step, and on the threshold
            let time = row.time as f64 * 1e-9;
            let (end, dt) = (row.step as f64 * self.scene.dt, self.scene.dt);
            assert!(time > end - dt - 1e-9 && time < end + 1e-9, "{text}");
            let [a, b] = [event.a, event.b].map(|i| &self.scene.bodies[i as usize]);
            let q = a.path().unwrap().position(time).distance(b.path().unwrap().position(time)) / (a.radius + b.radius);
            let level = match (event.from, event.to) {
                (Phase::Apart, Phase::Merged) => thresholds.merge_at,
                (Phase::Merged, Phase::Apart) => thresholds.split_at,
                _ => thresholds.core_at,
            };
            assert!((q - level).abs() < 1e-7, "{text}: {q} is not {level}");
        }
    }

    fn verify_diagnostics(&self) {
        let mut lines = DIAGNOSTICS.map(|_| BTreeMap::new());
        // integrator statistics cover all steps since the last frame
        let (mut substeps, mut error) = (0, 0.0);
        self.walk(|world| {
            substeps += world.report().substeps;
            error = f64::max(error, world.report().error);
            if !self.is_frame(world) {
                return;
            }
            let energy = world.energy();
            let displacement = |body: BodyView<'_>| {
                let lengths = (0..body.vertex_count()).map(|i| body.displacement(i).length());
                lengths.fold(0.0, f64::max) / body.scene().radius
            };
            let values = [
                energy.kinetic,
                energy.elastic,
                energy.total(),
                energy.influence,
                world.bodies().map(displacement).fold(0.0, f64::max),
                energy.reached_vertices as f64,
                std::mem::take(&mut substeps) as f64,
                std::mem::take(&mut error),
                world.bodies().filter(|body| body.is_at_rest()).count() as f64,
            ];
            for (line, value) in lines.iter_mut().zip(values) {
                line.insert(world.steps_taken(), value);
            }
        });
        for (name, values) in DIAGNOSTICS.into_iter().zip(lines) {
            let line = match name {
                name if name == "max_displacement" || name.starts_with("energy") => Line::Straight,
                _ => Line::Level,
            };
            self.verify_line(&format!("/diagnostics/{name}"), line, &values);
        }
    }

    /// Verifies a value for each stage at every frame after the first.
    fn verify_timings(&self) {
        for stage in TIMINGS {
            let rows = self.recording.changes(&format!("/timings/{stage}"));
            let steps: Vec<u64> = rows.iter().map(|row| row.step as u64).collect();
            assert_eq!(steps, self.frames()[1..], "{stage}");
            for row in rows {
                let milliseconds = row.scalar().expect("a number");
                assert!(
                    milliseconds.is_finite() && milliseconds >= 0.0,
                    "{stage} at step {}: {milliseconds}",
                    row.step
                );
            }
        }
        let speed = self.recording.changes("/timings/speed");
        assert_eq!(speed.len() + 2, self.frames().len(), "between two frames that were stepped to");
        assert!(speed.iter().all(|row| row.scalar().is_some_and(|speed| speed > 0.0)));
    }

    /// Verifies that a plot line has these values at these steps, repeats a value only where the line needs it, and is
    /// interrupted at frames without a value.
    fn verify_line(&self, entity: &str, line: Line, values: &BTreeMap<u64, f64>) {
        let track = self.track(entity);
        let (frames, mut rows) = (self.frames(), track.changes.len());
        for (frame, step) in frames.iter().enumerate() {
            assert_eq!(track.held[frame].scalar(), values.get(step).copied(), "{entity} at step {step}");
        }
        for spell in frames.chunk_by(|a, b| values.contains_key(a) == values.contains_key(b)) {
            let (first, last) = (spell[0], spell[spell.len() - 1]);
            let logged: Vec<(u64, Option<f64>)> = {
                let rows = track.changes.range(first..=last);
                rows.map(|(&step, row)| (step, row.scalar())).collect()
            };
            rows -= logged.len();
            if !values.contains_key(&first) {
                let is_interruption = first > 0 && values.keys().any(|&step| step < first);
                assert_eq!(
                    logged,
                    is_interruption.then_some((first, None)).into_iter().collect::<Vec<_>>(),
                    "{entity}"
                );
                continue;
            }
            let ends = [logged[0].0, logged[logged.len() - 1].0];
            assert_eq!(ends, [first, last], "{entity} reaches from end to end");
            for &[(from, before), (to, after)] in logged.array_windows() {
                let is_straight = before == after || values.range(from + 1..to).next().is_none();
                assert!(line != Line::Straight || is_straight, "{entity}: from {from} to {to} it is not straight");
                let next = values.range((Excluded(to), Included(last))).next().map(|(_, value)| *value);
                let is_needed = match line {
                    Line::Straight => next != after,
                    Line::Level => next.is_none(),
                    Line::Threshold => next.is_none() || (to / self.settings.every).is_multiple_of(64),
                };
                assert!(before != after || is_needed, "{entity}: {after:?} is repeated at step {to}");
            }
        }
        assert_eq!(rows, 0, "{entity} is logged at frames only");
    }

    /// Every distinct shape.
    fn shapes(&self) -> Vec<Shape> {
        let mut shapes: Vec<Shape> = Vec::new();
        for body in &self.scene.bodies {
            if !shapes.contains(&body.shape) {
                shapes.push(body.shape.clone());
            }
        }
        shapes
    }
}

const CAUSES: [&str; 8] = ["attraction", "repulsion", "core", "restoring", "damping", "push", "carry", "net"];
const TIMINGS: [&str; 7] = ["reach", "events", "integrate", "observe", "wait", "extract", "log"];
const DIAGNOSTICS: [&str; 9] = [
    "energy_vibration",
    "energy_elastic",
    "energy",
    "energy_influence",
    "max_displacement",
    "reached_vertices",
    "substeps",
    "estimated_error",
    "sleeping_bodies",
];

const TRANSLATION: &str = "Transform3D:translation";
const POSITIONS: &str = "Mesh3D:vertex_positions";
const NORMALS: &str = "Mesh3D:vertex_normals";

/// The interpolation of a plot line between values.
#[derive(Clone, Copy, PartialEq)]
enum Line {
    /// Linear.
    Straight,
    /// Constant until the next value.
    Level,
    /// Constant throughout; repeated at intervals, so that it keeps up with a live plot.
    Threshold,
}

fn resting(shape: &Shape) -> String {
    let Shape::Sphere(Sphere { stacks, slices }) = shape else { panic!("a sphere") };
    format!("/world/resting/sphere_{stacks}x{slices}")
}

fn triangles(mesh: &Row) -> Vec<[u32; 3]> {
    mesh.get::<UVec3D>("Mesh3D:triangle_indices").into_iter().map(|triangle| triangle.0).collect()
}

/// The mean of the accelerations of a body's vertices, by mass if it is free; zero where only rounding is left.
fn mean_acceleration(world: &World, index: usize, of: &Vectors) -> DVec3 {
    let body = world.body(index);
    let is_free = body.scene().path().is_none();
    let share = |i: usize| if is_free { body.mesh().shares()[i] } else { 1.0 / of.len() as f64 };
    let parts: Vec<DVec3> = (0..of.len()).map(|i| of.get(i) * share(i)).collect();
    let sum: DVec3 = parts.iter().sum();
    if sum.length() > 1e-12 * parts.iter().map(|part| part.length()).sum::<f64>() { sum } else { DVec3::ZERO }
}

/// The group of each body: bodies whose pairs are not apart, and those joined by others.
fn groups(world: &World) -> Vec<usize> {
    let mut groups: Vec<usize> = (0..world.body_count()).collect();
    for pair in world.pairs().filter(|pair| pair.phase != Phase::Apart) {
        let (one, other) = (groups[pair.a], groups[pair.b]);
        groups.iter_mut().filter(|group| **group == other).for_each(|group| *group = one);
    }
    groups
}

/// How often a closed mesh winds around a point: the sum of the solid angles of its triangles, over 4π (van Oosterom and
/// Strackee, 1983).
fn winding_number(positions: &[DVec3], triangles: &[[u32; 3]], at: DVec3) -> f64 {
    let angle = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|corner| positions[corner as usize] - at);
        let [la, lb, lc] = [a, b, c].map(DVec3::length);
        let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        2.0 * a.dot(b.cross(c)).atan2(below)
    };
    triangles.iter().map(angle).sum::<f64>() / (4.0 * std::f64::consts::PI)
}

/// A number with at least three digits.
fn significant(x: f64) -> String {
    let digits = 2 - x.abs().log10().floor().clamp(-9.0, 2.0) as i32;
    if x == 0.0 { "0".to_owned() } else { format!("{x:.*}", digits as usize) }
}

/// The least and the largest corner of the box around spheres.
fn bounds(spheres: &[(DVec3, f64)]) -> [DVec3; 2] {
    let corners = spheres.iter().map(|&(centre, radius)| [-1.0, 1.0].map(|side| centre + side * radius));
    corners.reduce(|one, other| [one[0].min(other[0]), one[1].max(other[1])]).expect("a sphere")
}

/// The diagonal of the box around spheres.
fn width(spheres: &[(DVec3, f64)]) -> f64 {
    let [low, high] = bounds(spheres);
    low.distance(high)
}

/// The usual look at the bodies of a frame, which are balls.
struct Look<'a> {
    world: &'a World,
    /// To the right, upwards, and towards the eye.
    axes: [DVec3; 3],
    eye: DVec3,
    /// The distance of the eye from the middle of the bodies.
    distance: f64,
}

impl Look<'_> {
    /// In a run within the spheres `framed`: from where these are just in view, unless the bodies alone would be much larger.
    fn new<'w>(world: &'w World, framed: &[(DVec3, f64)]) -> Look<'w> {
        let bodies: Vec<(DVec3, f64)> = world.bodies().map(|body| (body.centre(), body.scene().radius)).collect();
        let [low, high] = bounds(&bodies);
        let is_wide = width(framed) > 1.6 * low.distance(high);
        let spheres: Vec<_> = bodies.iter().chain(framed.iter().filter(|_| !is_wide)).copied().collect();
        let [lowest, highest] = bounds(&spheres);
        let extent = highest - lowest;
        let is_flat = extent.z < 0.35 * extent.x.min(extent.y);
        let back = DVec3::new(-0.2, -1.0, if is_flat { 1.0 } else { 0.4 }).normalize();
        let right = DVec3::new(1.0, -0.2, 0.0).normalize();
        let up = back.cross(right);
        // how far back an eye at this coordinate along an axis has to be to see all, in a view of 55° by 1.45 times that, with
        // margins of 4 % of half its height
        let away = |(axis, half): (DVec3, f64), at: f64| {
            let of = |(centre, radius): &(DVec3, f64)| {
                centre.dot(back) + ((centre.dot(axis) - at).abs() + radius * half.hypot(1.0)) / half
            };
            spheres.iter().map(of).fold(f64::NEG_INFINITY, f64::max)
        };
        // the coordinate with the least of that, by ternary search of a convex function
        let best = |side: (DVec3, f64)| {
            let [mut low, mut high] = [-1.0, 1.0].map(|side| side * 10.0 * (1.0 + extent.length() + lowest.length()));
            for _ in 0..200 {
                let [one, other] = [(2.0 * low + high) / 3.0, (low + 2.0 * high) / 3.0];
                if away(side, one) <= away(side, other) { high = other } else { low = one }
            }
            0.5 * (low + high)
        };
        let sides = [(right, (1.45 - 0.04) * 0.5205), (up, 0.96 * 0.5205)];
        let [x, y] = sides.map(best);
        let eye = x * right + y * up + f64::max(away(sides[0], x), away(sides[1], y)) * back;
        let distance = (eye - 0.5 * (low + high)).dot(back);
        Look { world, axes: [right, up, back], eye, distance }
    }

    /// Whether one of two labels, of which the places of the middle and the numbers of characters are given, covers the
    /// other, if their sizes are multiplied by `size`.
    fn covers(&self, labels: [(DVec3, usize); 2], size: f64) -> bool {
        let [right, up, back] = self.axes;
        let [one, other] = labels.map(|(place, _)| {
            let from = place - self.eye;
            self.distance / f64::max(-from.dot(back), 0.1 * self.distance)
                * DVec3::new(from.dot(right), from.dot(up), 0.0)
        });
        let width = self.distance * (0.03 + 0.0095 * (labels[0].1 + labels[1].1) as f64);
        let apart = (one - other).abs();
        apart.x <= size * width && apart.y <= size * 0.07 * self.distance
    }

    /// Whether a place on a body is behind another body that is well in front of it, or may be for an eye elsewhere.
    fn is_at_rim(&self, index: usize, place: DVec3) -> bool {
        let way = (place - self.eye).normalize();
        self.world.bodies().enumerate().filter(|(other, _)| *other != index).any(|(_, body)| {
            let (to, radius) = (body.centre() - self.eye, body.scene().radius);
            let along = to.dot(way);
            along > 0.0
                && along < self.eye.distance(place) - 0.5 * radius
                && (to - along * way).length() < 1.05 * radius
        })
    }

    /// Whether the sphere of another body is in front of a place on a body, by more than `depth` [its radii].
    fn is_hidden(&self, index: usize, place: DVec3, depth: f64) -> bool {
        if self.world.bodies().len() > 64 {
            return false; // nothing hides a place
        }
        let way = place - self.eye;
        self.world.bodies().enumerate().filter(|(other, _)| *other != index).any(|(_, body)| {
            let radius = body.scene().radius;
            // the first point of the line of sight in the other body: of x² + 2 b x + c = 0 the smaller root
            let from = self.eye - body.centre();
            let (b, c) = (from.dot(way) / way.length(), from.length_squared() - radius * radius);
            let root = b * b - c;
            root > 0.0 && -b > 0.0 && -b - root.sqrt() < way.length() - depth * radius
        })
    }

    /// Verifies that labels, each of which has the index of its body, the place of its middle and its number of characters,
    /// stand on their bodies, where these are seen, and do not cover each other.
    fn assert_readable(&self, labels: &[(usize, DVec3, usize)], at: &str) {
        self.assert_readable_through(0, labels, at);
    }

    /// The same, if the first bodies may be hidden.
    fn assert_readable_through(&self, hidden: usize, labels: &[(usize, DVec3, usize)], at: &str) {
        for (number, &(index, place, length)) in labels.iter().enumerate() {
            let nearest = self.places(index).map(|of| of.distance(place)).fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-6 * self.distance, "{at}: {index} is labelled {nearest} from its places");
            let is_hidden = number >= hidden && self.is_hidden(index, place, 0.151);
            assert!(!is_hidden, "{at}: the label of {index} is on another body");
            for &(_, other, other_length) in &labels[..number] {
                assert!(!self.covers([(place, length), (other, other_length)], 0.799), "{at}: {labels:?}");
            }
        }
    }

    /// Whether there is clearly room on a body for a label of this length beside other labels.
    fn has_room(&self, index: usize, length: usize, labels: &[(usize, DVec3, usize)]) -> bool {
        self.places(index).any(|place| {
            let others = labels.iter().filter(|of| of.0 != index);
            let is_clear = |&(_, other, other_length): &(usize, DVec3, usize)| {
                !self.covers([(place, length), (other, other_length)], 1.001)
            };
            !self.is_hidden(index, place, 0.019) && others.into_iter().all(is_clear)
        })
    }

    /// The places on the front of a body for its label: on eight sides, and in the middle.
    fn places(&self, index: usize) -> impl Iterator<Item = DVec3> {
        let [right, up, back] = self.axes;
        let body = self.world.body(index);
        let eighths = (0..8).map(|eighth| f64::from(eighth) * std::f64::consts::FRAC_PI_4);
        let sides = eighths.map(move |angle| 0.8 * (angle.cos() * up + angle.sin() * right));
        sides.chain([DVec3::ZERO]).map(move |side| {
            let direction = (side + 0.6 * back).normalize();
            body.centre() + body.scene().radius * direction
        })
    }
}

/// Verifies which bodies are labelled: of the five strongest of `all`, those above `least` that have room.
fn assert_labelled(
    labelled: &[usize],
    all: &[usize],
    strength: impl Fn(usize) -> f64,
    least: f64,
    has_room: impl Fn(usize) -> bool,
    at: &str,
) {
    // equal ones are in any order
    let stronger = |body: usize, by: f64| {
        let limit = strength(body) * by;
        all.iter().filter(|&&other| other != body && strength(other) > limit).count()
    };
    assert!(labelled.len() <= 5, "{at}: {labelled:?}");
    for &body in all {
        match labelled.contains(&body) {
            true => assert!(stronger(body, 1.0 + 1e-12) < 5, "{at}: {body} in {labelled:?}"),
            false => assert!(
                stronger(body, 1.0 - 1e-12) >= 5 || strength(body) <= least || !has_room(body),
                "{at}: {body} beside {labelled:?}"
            ),
        }
    }
}

/// Asserts equality; reports only the first difference.
fn assert_same<T: PartialEq + std::fmt::Debug>(found: &[T], expected: &[T], at: &str) {
    assert_eq!(found.len(), expected.len(), "{at}");
    let differs = found.iter().zip(expected).position(|(found, expected)| found != expected);
    if let Some(i) = differs {
        panic!("{at}: {:?} instead of {:?} at index {i}", found[i], expected[i]);
    }
}

/// The normalised sums of the area vectors of the triangles around each vertex.
fn area_normals(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<DVec3> {
    let mut areas = vec![DVec3::ZERO; positions.len()];
    for corners in triangles {
        let [a, b, c] = corners.map(|corner| positions[corner as usize]);
        let area = 0.5 * (b - a).cross(c - a);
        corners.iter().for_each(|&corner| areas[corner as usize] += area);
    }
    areas.into_iter().map(DVec3::normalize).collect()
}

/// Verifies that normals have unit length and are area-weighted.
fn verify_normals(body: &BodyView<'_>, normals: &[Vec3], at: &str) {
    let positions: Vec<DVec3> = (0..body.vertex_count()).map(|i| body.local_position(i)).collect();
    let expected = area_normals(&positions, body.mesh().triangles());
    assert_eq!(normals.len(), expected.len(), "{at}");
    for (vertex, (normal, expected)) in normals.iter().zip(expected).enumerate() {
        assert!((normal.length() - 1.0).abs() < 1e-6, "{at}: vertex {vertex} {normal}");
        assert!(normal.as_dvec3().distance(expected) < 1e-5, "{at}: vertex {vertex} {normal} {expected}");
    }
}

// ---- scenes --------------------------------------------------------------------------------------------------------

#[test]
fn push_is_recorded_exactly() {
    Run::new(&builtin("push")).verify();
}

#[test]
fn what_a_scene_changes_is_listed() {
    let text = "duration = 1.0\n[[body]]\nname = \"a\"\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n\
                [[push]]\nbody = \"a\"\ndirection = [1, 0, 0]\nstrength = 9.0\nstart = 0.0\nduration = 0.25\n\
                [[point]]\nname = \"finger\"\nradius = 0.5\nact = \"attract\"\nstart = 0.5\nmotion = { fixed = [1, 0, 0] }\n\
                [[edit]]\ntime = 0.76\nset = { \"material.omega\" = 9.0 }\n[[edit]]\ntime = 3.0\nset = { \"material.omega\" = 8.0 }\n";
    let run = Run::new(&Scene::parse(text, "listed.toml").expect("a valid scene"));
    let rows = run.recording.rows(&EntityPath::from("/events/scheduled"));
    let rows: Vec<String> = rows.iter().map(|(_, row)| row.text("TextLog:text").to_owned()).collect();
    let expected = [
        "push on a ends at t = 0.250000 s, step 15",
        "force point finger begins to act at t = 0.500000 s, step 30",
        "edit: material.omega = 9.0 at t = 0.760000 s, step 46",
    ];
    assert_eq!(rows, expected);
    assert_eq!(run.recording.rows(&EntityPath::from("/marks/axis/scheduled")).len(), 3);
}

#[test]
fn two_is_recorded_exactly() {
    Run::new(&builtin("two")).verify();
}

#[test]
fn three_is_recorded_exactly() {
    Run::new(&builtin("three")).verify();
}

#[test]
fn size_ratio_is_recorded_exactly() {
    Run::new(&builtin("size_ratio")).verify();
}

/// Two bodies that pass through each other, and therefore through every phase, and one that is never touched; the names
/// are unusual.
fn crossing() -> Scene {
    let text = r#"
        name = "crossing/../[x]"
        duration = 5.0
        [influence]
        core_at = 0.5
        weight = "wendland"
        [[body]]
        name = "-"
        radius = 1.0
        shape = { sphere = { stacks = 6, slices = 8 } }
        motion = { fixed = [0, 0, 0] }
        [[body]]
        name = "A-1_b"
        radius = 0.7
        shape = { sphere = { stacks = 5, slices = 7 } }
        motion = { line = { from = [3, 0.1, 0], velocity = [-1.3, 0, 0.01] } }
        [[body]]
        name = "0"
        radius = 0.25
        motion = { sine = { center = [0, 9, 0], amplitude = [0, 0, 0.5], frequency = 0.5 } }
        [[push]]
        body = "0"
        direction = [0, 1, 0]
        strength = -3
        start = 2
        duration = 0.05
    "#;
    Scene::parse(text, "crossing.toml").expect("a valid scene")
}

#[test]
fn every_phase_is_recorded_exactly() {
    let run = Run::new(&crossing());
    run.verify();
    let names: Vec<&str> = run.events().iter().map(Event::name).collect();
    assert_eq!(names, ["merge", "core", "core left", "split"]);
    let rows = run.recording.rows(&EntityPath::from("/pairs/-~A-1_b/phase"));
    assert_eq!(rows.len(), 5);
}

/// A frame has no positions of a body at rest, which hides vertices all the same.
#[test]
fn a_body_at_rest_hides_the_vertices_inside_it() {
    let text = "duration = 1.5\n[influence]\nmerge_at = 0.2\nsplit_at = 0.3\nbeta = 20\n\
        [[body]]\nname = \"a\"\nradius = 1.0\nreach = 0.01\nmotion = { line = { from = [-2.6, 0.1, 0], velocity = [1.2, 0, 0] } }\n\
        [[body]]\nname = \"b\"\nradius = 1.0\nmotion = { fixed = [0, 0, 0] }\n";
    let run = Run::new(&Scene::parse(text, "rest.toml").expect("a valid scene"));
    run.verify_largest();
    let labels = run.recording.changes("/largest/bodies");
    let inside = labels.iter().filter(|row| row.texts("Points3D:labels").concat().contains(", inside a body")).count();
    assert!(inside > 10, "{inside} frames");
}

#[test]
fn skipped_frames_keep_their_events() {
    for scene in [crossing(), builtin("three")] {
        let settings = Settings { every: 7, ..Settings::of(&scene) };
        let run = Run::with(&scene, settings, 64);
        run.verify();
        assert!(run.events().iter().any(|event| event.step % 7 != 0), "{:?}", run.events());
    }
}

#[test]
fn forces_are_recorded_only_on_request() {
    let scene = crossing();
    let run = Run::with(&scene, Settings { detail: Detail::Surface, ..Settings::of(&scene) }, 64);
    run.verify();
    assert!(run.recording.entities().iter().all(|entity| !entity.to_string().contains("forces")));
}

/// A body that passes through a lattice of others, which soon come back to rest.
fn lattice(spacing: f64) -> Scene {
    let mut text = r#"
        name = "lattice"
        duration = 4.0
        [material]
        damping = 12.0
        response = "rigid"
        [[body]]
        name = "passing"
        radius = 0.8
        shape = { sphere = { stacks = 8, slices = 12 } }
        motion = { line = { from = [-3, 1.2, 0], velocity = [3, 0, 0] } }
    "#
    .to_owned();
    for i in 0..70 {
        let (x, y) = (f64::from(i % 10), f64::from(i / 10));
        let (stacks, slices) = if i % 3 == 0 { (5, 6) } else { (6, 8) };
        text += &format!(
            "[[body]]\nname = \"b{i}\"\nradius = {}\nshape = {{ sphere = {{ stacks = {stacks}, slices = {slices} }} }}\n\
             motion = {{ fixed = [{:?}, {:?}, 0] }}\n",
            if i % 2 == 0 { 1.0 } else { 0.9 },
            x * spacing,
            y * spacing,
        );
    }
    Scene::parse(&text, "lattice.toml").expect("a valid scene")
}

#[test]
fn many_bodies_are_recorded_in_few_entities() {
    let run = Run::new(&lattice(2.6));
    assert_eq!(run.settings.entities, Entities::Batch);
    run.verify();
    let pair_entities = run.recording.entities().iter().filter(|e| e.to_string().starts_with("/pairs/")).count();
    assert!(run.recording.entities().len() - pair_entities <= 110);

    // bodies are touched, deform, and come to rest again
    let mut deformed = Vec::new();
    for row in run.recording.changes("/world/deforming/surface").iter().filter(|row| row.has("body")) {
        deformed.push(row.texts("body").iter().collect::<BTreeSet<_>>().len());
    }
    assert!(deformed.len() > 5 && deformed.iter().any(|&n| n >= 3), "{deformed:?}");
    let fewer = deformed.array_windows().filter(|[before, after]| after < before).count();
    assert!(fewer > 0, "some are back at rest: {deformed:?}");
}

#[test]
fn a_crowd_is_recorded_exactly() {
    let scene = Scene { duration: 0.5, ..builtin("crowd") };
    let run = Run::new(&scene);
    run.verify();
    assert!(run.recording.entities().len() <= 133, "{}", run.recording.entities().len());
    assert!((MOST_PAIRS_OF_MANY..=2 * MOST_PAIRS_OF_MANY).contains(&run.pairs().len()), "{:?}", run.pairs());
}

#[test]
fn many_bodies_can_be_recorded_by_frame_and_without_forces() {
    let scene = lattice(2.6);
    let settings = Settings { every: 7, detail: Detail::Surface, ..Settings::of(&scene) };
    Run::with(&scene, settings, 64).verify();
}

#[test]
fn batching_can_be_chosen_for_any_number_of_bodies() {
    let scene = crossing();
    Run::with(&scene, Settings { entities: Entities::Batch, ..Settings::of(&scene) }, 64).verify();
    let scene = Scene { duration: 0.5, ..lattice(2.6) };
    Run::with(&scene, Settings { entities: Entities::Body, ..Settings::of(&scene) }, 64).verify();
}

#[test]
fn in_a_crowd_pairs_with_events_have_entities() {
    let run = Run::new(&Scene { duration: 1.0, ..lattice(2.2) });
    run.verify();
    // pairs that come within reach, and up to the same number of pairs with events
    assert!((MOST_PAIRS_OF_MANY..=2 * MOST_PAIRS_OF_MANY).contains(&run.pairs().len()), "{:?}", run.pairs());
    let with_events: HashSet<_> = run.events().iter().map(|event| (event.a as usize, event.b as usize)).collect();
    assert!(!with_events.is_empty() && with_events.len() <= MOST_PAIRS_OF_MANY, "{:?}", run.events());
    assert!(with_events.iter().all(|pair| run.pairs().contains(pair)), "{:?}", run.pairs());
}

/// Everything in a recording except the timings, by entity: row ids, times, values.
pub fn content(recording: &Recording) -> BTreeMap<EntityPath, (Row, Vec<(RowId, Row)>)> {
    let entities = recording.entities().into_iter().filter(|entity| !entity.to_string().starts_with("/timings/"));
    entities.map(|entity| (entity.clone(), (recording.fixed(&entity.to_string()), recording.rows(&entity)))).collect()
}

#[test]
fn equal_runs_give_equal_data() {
    for scene in [crossing(), Scene { duration: 1.0, ..lattice(2.6) }] {
        // the machine determines how often a run sends its data
        let [one, other] = [64, 5].map(|taken_every| Run::with(&scene, Settings::of(&scene), taken_every).recording);
        assert_eq!(one.id, other.id);
        let (one_content, other_content) = (content(&one), content(&other));
        for (entity, rows) in &one_content {
            assert!(other_content.get(entity) == Some(rows), "{entity} differs");
        }
        assert_eq!(one_content.len(), other_content.len());
        let settings = Settings { every: 2, ..Settings::of(&scene) };
        assert_ne!(Run::with(&scene, settings, 64).recording.id, one.id, "other options, another recording");
    }
}

/// The stages of steps are on their own timeline, from the state before the step to the state after it.
#[test]
fn stages_within_steps_are_recorded() {
    let scene = builtin("two");
    let steps = 80..=90;
    let detail = Detail::Stages { from: *steps.start(), to: *steps.end() };
    let run = Run::with(&scene, Settings { detail, steps: Some(100), ..Settings::of(&scene) }, 64);
    let mut lines = Vec::new();
    let mut positions: BTreeMap<i64, Vec<Vec3>> = BTreeMap::new();
    let store = run.recording.store.read();
    for chunk in store.iter_physical_chunks() {
        let Some(times) = chunk.timelines().get(&TimelineName::from("stage")) else { continue };
        // the list can be read at any step, the states only one by one
        let count = if chunk.entity_path() == &EntityPath::from("/stages") { 3 } else { 1 };
        assert_eq!(chunk.timelines().len(), count, "{}", chunk.entity_path());
        let texts = chunk.iter_slices::<String>("TextLog:text".into());
        lines.extend(times.times_raw().iter().zip(texts).map(|(&stage, text)| (stage, text[0].to_string())));
        if chunk.entity_path() == &EntityPath::from("/world/bodies/b/surface") {
            let vectors = chunk.iter_slices::<[f32; 3]>(POSITIONS.into());
            let rows = times.times_raw().iter().zip(vectors);
            positions.extend(rows.map(|(&stage, row)| (stage, row.iter().map(|&v| Vec3::from(v)).collect())));
        }
    }
    lines.sort();
    let numbers: Vec<i64> = lines.iter().map(|(stage, _)| *stage).collect();
    assert_eq!(numbers, (0..lines.len() as i64).collect::<Vec<_>>());
    for step in steps {
        let of_step: Vec<&(i64, String)> =
            lines.iter().filter(|(_, line)| line.starts_with(&format!("step {step}: "))).collect();
        let names = of_step.iter().filter_map(|(_, line)| line.split(": ").nth(1)?.split(" — ").next());
        let names: Vec<&str> = names.collect();
        assert_eq!(names[..2], ["start", "start, with the influence forces alone"]);
        assert_eq!(names[names.len() - 2..], ["end if no sphere acted", "end"]);
        assert_eq!(names.iter().any(|name| name.starts_with("merge a~b")), step == 84, "{names:?}");
        // the values at the first stage and at the last are the frames before and after
        for (stage, frame) in [(of_step[0].0, step - 1), (of_step[of_step.len() - 1].0, step)] {
            let held = positions.range(..=stage).next_back().expect("a surface").1;
            let frame = run.recording.held("/world/bodies/b/surface", [frame]);
            assert_eq!(held, &frame[0].vectors(POSITIONS), "step {step}, stage {stage}");
        }
    }
}

/// Plots get their ranges once their values are known, and the file opens at the first event; the blueprint is then
/// activated again.
#[test]
fn a_file_ends_with_the_ranges_of_its_plots_and_opens_at_its_first_event() {
    let scene = builtin("two");
    let mut world = World::new(scene.clone()).expect("enough memory");
    let settings = Settings::of(&scene);
    let mut recorder = Recorder::new(&world, settings.clone()).expect("its text describes it");
    assert!(recorder.measured_layout(&world, Tab::Scene).is_empty(), "nothing was measured");
    for _ in 0..100 {
        let mut summary = StepSummary::default();
        Simulation::step(&mut world, &mut summary);
        recorder.observe(&world, &summary).expect("a valid step");
    }
    let store_of = |messages: &[LogMsg]| messages.last().expect("messages").store_id().clone();
    let layout = recorder.blueprint(&world, Tab::Timings);
    let ranges = recorder.measured_layout(&world, Tab::Timings);
    assert_eq!(store_of(&ranges), store_of(&layout), "it is the same layout");
    assert!(matches!(ranges.last(), Some(LogMsg::BlueprintActivationCommand(_))));
    let (mut views, mut opening) = (BTreeSet::new(), Vec::new());
    for message in &ranges[..ranges.len() - 1] {
        let LogMsg::ArrowMsg(_, message) = message else { panic!("{message:?}") };
        let chunk = Chunk::from_arrow_msg(message).expect("a chunk");
        if chunk.components().keys().any(|component| component.as_str() == "ScalarAxis:range") {
            assert!(views.insert(chunk.entity_path().to_string()));
        } else {
            opening.extend(chunk.components().keys().map(|component| component.to_string()));
        }
    }
    // the plots of timings and of q, each in the first tab and in its own, of the recording and of speed, five of scalars,
    // those of gap, of neck, of overlap and of volume, that of displacements, and those of the net forces on two bodies
    assert_eq!(views.len(), 18, "{views:?}");
    for component in ["TimePanelBlueprint:time_selection", "TimePanelBlueprint:play_state", "EyeControls3D:position"] {
        assert!(opening.iter().any(|logged| logged == component), "{opening:?}");
    }

    let thin = Settings { frames: Frames::Thin, ..settings };
    assert!(Recorder::new(&world, thin).expect("its text describes it").measured_layout(&world, Tab::Scene).is_empty());
}

/// A probe passes ten bodies: it merges with five and misses five, ever less closely. Eight lines are drawn: those of the five,
/// and of the three that it missed most closely, which alone are marked.
#[test]
fn of_many_pairs_the_closest_are_drawn_with_their_near_misses() {
    let mut text = "duration = 6.0\n".to_owned();
    let mut body = |name: &str, motion: String| {
        text += &format!("[[body]]\nname = \"{name}\"\nradius = 1.0\nmotion = {motion}\n");
        text += "shape = { sphere = { stacks = 4, slices = 6 } }\n";
    };
    body("probe", "{ line = { from = [-5, 0, 0], velocity = [10, 0, 0] } }".to_owned());
    let closest = |i: usize| if i < 5 { 0.9 } else { 1.06 + 0.02 * (i - 5) as f64 };
    for i in 0..10 {
        body(&format!("b{i}"), format!("{{ fixed = [{:?}, {:?}, 0] }}", 5.0 * i as f64, 2.0 * closest(i)));
    }
    let run = Run::new(&Scene::parse(&text, "probe.toml").expect("a valid scene"));
    let marked = |family: &str| {
        let rows = run.recording.rows(&EntityPath::from(format!("/marks/{family}/near_miss").as_str()));
        let mut marked: Vec<f64> = rows.iter().map(|(_, row)| row.scalar().expect("q")).collect();
        marked.sort_by(f64::total_cmp);
        marked
    };
    for (family, expected) in [("q", 5..10), ("drawn", 5..8)] {
        let (marked, expected) = (marked(family), expected.map(closest).collect::<Vec<_>>());
        assert_eq!(marked.len(), expected.len(), "{family}: {marked:?}");
        assert!(marked.iter().zip(&expected).all(|(found, q)| (found - q).abs() < 1e-9), "{family}: {marked:?}");
    }
}

/// Thresholds far from all q leave the axis to its lines, and the title says of which pairs.
#[test]
fn thresholds_far_from_q_are_beyond_the_axis() {
    let titles = |merge_at: f64| {
        let pair = format!("[[pair]]\nbodies = [\"a\", \"b\"]\nmerge_at = {merge_at}\nsplit_at = {}\n", 1.1 * merge_at);
        let scene = Scene::parse(&(builtin("two").source.to_string() + &pair), "far.toml").expect("a valid scene");
        let mut world = World::new(scene.clone()).expect("enough memory");
        let mut recorder = Recorder::new(&world, Settings::of(&scene)).expect("its text describes it");
        for _ in 0..60 {
            let mut summary = StepSummary::default();
            Simulation::step(&mut world, &mut summary);
            recorder.observe(&world, &summary).expect("a valid step");
        }
        let titles = texts_of_layout(&recorder.measured_layout(&world, Tab::Scene), "ViewBlueprint:display_name");
        titles
            .into_iter()
            .map(|(_, title)| title)
            .filter(|title| title.starts_with("Pair distances"))
            .collect::<Vec<_>>()
    };
    assert_eq!(titles(1.0), Vec::<String>::new());
    let far = "Pair distances q and their thresholds; thresholds of a~b beyond the axis";
    assert_eq!(titles(0.01), [far; 2]);
}

/// Components of the messages of a layout: each with its entity and its text.
fn texts_of_layout(messages: &[LogMsg], component: &str) -> Vec<(String, String)> {
    let chunks = messages.iter().filter_map(|message| match message {
        LogMsg::ArrowMsg(_, message) => Some(Chunk::from_arrow_msg(message).expect("a chunk")),
        _ => None,
    });
    let texts = chunks.flat_map(|chunk| {
        let found = chunk.components().values().find(|of| of.descriptor.component.as_str() == component).cloned();
        let entity = chunk.entity_path().to_string();
        let values = found.map(|of| of.list_array.values().clone());
        let strings = values.and_then(|values| {
            let texts = values.as_string_opt::<i32>()?;
            Some(texts.iter().flatten().map(str::to_owned).collect::<Vec<_>>())
        });
        strings.unwrap_or_default().into_iter().map(move |text| (entity.clone(), text))
    });
    texts.collect()
}

#[test]
fn plots_and_lanes_share_one_time_range_and_leave_out_what_stays_0() {
    let scene = builtin("orbit");
    let mut world = World::new(scene.clone()).expect("enough memory");
    let mut recorder = Recorder::new(&world, Settings::of(&scene)).expect("its text describes it");
    let layout = recorder.blueprint(&world, Tab::Energy);
    let classes = texts_of_layout(&layout, "ViewBlueprint:class_identifier");
    let linked = |view: &str| {
        layout.iter().any(|message| match message {
            LogMsg::ArrowMsg(_, message) => {
                let chunk = Chunk::from_arrow_msg(message).expect("a chunk");
                let has_link = chunk.components().keys().any(|of| of.as_str() == "TimeAxis:link");
                has_link && chunk.entity_path().to_string() == format!("{view}/TimeAxis")
            }
            _ => false,
        })
    };
    for class in ["TimeSeries", "StateTimeline"] {
        let views: Vec<_> = classes.iter().filter(|(_, of)| of == class).collect();
        assert!(views.len() >= 3, "{class}: {views:?}");
        views.iter().for_each(|(view, _)| assert!(linked(view), "{class}: {view}"));
    }

    for _ in 0..50 {
        let mut summary = StepSummary::default();
        Simulation::step(&mut world, &mut summary);
        recorder.observe(&world, &summary).expect("a valid step");
    }
    let measured = recorder.measured_layout(&world, Tab::Energy);
    let title = "Energy [mass·unit²/s²] by kind; always 0: gravity, planes";
    let (plot, _) = texts_of_layout(&measured, "ViewBlueprint:display_name")
        .into_iter()
        .find(|(_, name)| name == title)
        .expect("a title");
    let rules: Vec<String> = texts_of_layout(&measured, "ViewContents:query")
        .into_iter()
        .filter(|(view, _)| *view == format!("{plot}/ViewContents"))
        .map(|(_, rule)| rule)
        .collect();
    let shows = |line: &str| rules.iter().any(|rule| rule == &format!("+ /diagnostics/{line}"));
    assert!(shows("energy") && shows("energy_spin") && !shows("energy_gravity") && !shows("energy_plane"), "{rules:?}");
}
