//! The page of `meldscope live`, as a program that speaks HTTP sees it; `.ci/live.py` looks at it in a browser.

use std::{
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::{Ipv4Addr, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::Duration,
};

use meldscope::{
    Scene, World,
    live::{Live, Options},
    models::SceneRun,
    observe::{Experiment, InvalidVariation, Parameter, Refusal, Schema, Simulation, Variation},
    recording::{Recorded, replay},
    sim,
    stream::sinks::Serve,
};
use serde_json::Value;

use crate::recording::Dir;

struct Page {
    live: Live,
    port: u16,
    /// `/TOKEN`
    path: String,
    dir: Dir,
}

impl Page {
    fn open(text: &str) -> Page {
        Page::of(text, |run| Arc::new(run))
    }

    /// A page of the scene, `made` an experiment.
    fn of(text: &str, made: impl FnOnce(SceneRun) -> Arc<dyn Experiment>) -> Page {
        // a flag for each page, because its runs are interrupted through it
        let interrupt: &'static AtomicBool = Box::leak(Box::default());
        let scene = Scene::parse(text, "page.toml").expect("a scene");
        let options = sim::Options { interrupt: Some(interrupt), ..sim::Options::default() };
        let dir = Dir::new();
        let serve = Serve { web_port: 0, ..Serve::default() };
        let page = Options { serve, save: dir.path().join("page.rrd"), interrupt };
        let live = Live::start(made(SceneRun { scene, options }), page).expect("a free port");
        let (port, path) = {
            let rest = live.address.strip_prefix("http://127.0.0.1:").expect("an address of this machine");
            let (port, path) = rest.split_once('/').expect("a path");
            (port.parse().expect("a port"), format!("/{}", path.trim_end_matches('/')))
        };
        Page { live, port, path, dir }
    }

    fn two() -> Page {
        Page::open(&Scene::builtin("two").expect("built in").source)
    }

    fn send(&self, request: &str) -> TcpStream {
        let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, self.port)).expect("it listens");
        stream.set_read_timeout(Some(Duration::from_secs(60))).expect("a timeout");
        stream.write_all(request.as_bytes()).expect("it reads");
        stream
    }

    /// Status, head and body of the answer. In HTTP 1.0, the end of the connection is that of the body.
    fn ask(&self, line: &str, headers: &str, body: &str) -> (u16, String, Vec<u8>) {
        let length = body.len();
        let mut stream = self.send(&format!("{line} HTTP/1.0\r\n{headers}content-length: {length}\r\n\r\n{body}"));
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).expect("the answer is whole");
        let end = answer.windows(4).position(|end| end == b"\r\n\r\n").expect("a head") + 4;
        let body = answer.split_off(end);
        let head = String::from_utf8(answer).expect("text");
        (head[9..12].parse().expect("a status"), head, body)
    }

    fn get(&self, path: &str) -> (u16, String, Vec<u8>) {
        self.ask(&format!("GET {}/{path}", self.path), "host: localhost\r\n", "")
    }

    fn post(&self, path: &str, body: &str) -> u16 {
        self.ask(&format!("POST {}/{path}", self.path), "host: localhost\r\n", body).0
    }

    fn feed(&self) -> Feed {
        let stream = self.send(&format!("GET {}/feed HTTP/1.0\r\nhost: localhost\r\n\r\n", self.path));
        Feed(BufReader::new(stream))
    }
}

struct Feed(BufReader<TcpStream>);

impl Feed {
    /// The next message of a kind that satisfies a condition.
    fn next(&mut self, kind: &str, is_it: impl Fn(&Value) -> bool) -> Value {
        loop {
            let mut line = String::new();
            assert!(self.0.read_line(&mut line).expect("the feed goes on") > 0, "the feed has ended");
            let Some(text) = line.strip_prefix("data: ") else { continue };
            let message: Value = serde_json::from_str(text).expect("JSON");
            if message["kind"] == kind && is_it(&message) {
                return message;
            }
        }
    }

    fn run(&mut self, number: u64) -> Value {
        self.next("run", |message| message["number"] == number)
    }
}

/// Time of the first event of this name.
fn time(run: &Value, name: &str) -> f64 {
    let events = run["events"].as_array().expect("events");
    let event = events.iter().find(|event| event["event"] == name).unwrap_or_else(|| panic!("no {name} in {events:?}"));
    event["time"].as_f64().expect("a time")
}

#[test]
fn a_change_is_answered_by_the_run_of_the_changed_scene() {
    let page = Page::two();
    let mut feed = page.feed();
    let scene = feed.next("scene", |_| true);
    let parameters = scene["parameters"].as_array().expect("parameters");
    assert!(parameters.iter().any(|parameter| parameter["key"] == "influence.merge_at"));
    let own = time(&feed.run(1), "merge a~b");

    assert_eq!(page.post("change", r#"{"values": {"influence.merge_at": 0.98}, "cursor": 150}"#), 200);
    let changed = time(&feed.run(2), "merge a~b");
    let text = Scene::builtin("two").unwrap().source.replace("merge_at = 1.05", "merge_at = 0.98");
    let scene = Scene::parse(&text, "two.toml").expect("a scene");
    let mut world = World::new(scene).unwrap();
    let expected = loop {
        if let Some(event) = world.step().events.first() {
            break event.time;
        }
    };
    assert_eq!(changed, expected);
    assert!(changed > own + 0.1);

    feed.next("frames", |message| message["number"] == 2);
    let (status, _, bytes) = page.get("first/2.rrd");
    assert_eq!(status, 200);
    let file = page.dir.path().join("read.rrd");
    std::fs::write(&file, bytes).unwrap();
    let recorded = Recorded::open(&file).expect("a recording");
    assert!(matches!(replay::verify(&recorded, |_| true), Ok(replay::Verdict::Identical)));
}

#[test]
fn a_wrong_value_keeps_the_run_and_says_what_is_right() {
    let page = Page::two();
    let mut feed = page.feed();
    feed.run(1);
    assert_eq!(page.post("change", r#"{"values": {"influence.merge_at": 1.3}}"#), 200);
    let problem = feed.next("problem", |_| true);
    assert_eq!(problem["key"], "influence.split_at", "{problem}");
    assert!(problem["text"].as_str().unwrap().contains("merge_at"), "{problem}");
    assert_eq!(page.post("change", r#"{"values": {"influence.nothing": 1.3}}"#), 200);
    let problem = feed.next("problem", |message| message["key"] == "influence.nothing");
    assert!(problem["text"].as_str().unwrap().contains("unknown key"), "{problem}");
    assert_eq!(page.post("change", "{"), 400);
    assert_eq!(page.post("change", &" ".repeat(300 << 10)), 413);
    assert_eq!(page.get("first/1.rrd").0, 200);
    assert_eq!(page.post("change", r#"{"values": {}}"#), 200);
    feed.run(4);
}

/// The run of the last valid change goes on to its end, beside what is wrong with the newest.
#[test]
fn a_wrong_value_does_not_cut_the_run_before_it_short() {
    let page = Page::open(&Scene::builtin("crowd").expect("built in").source);
    let mut feed = page.feed();
    assert_eq!(page.post("change", r#"{"values": {"material.omega": 13}}"#), 200);
    feed.next("open", |message| message["number"] == 2);
    assert_eq!(page.post("change", r#"{"values": {"material.omega": 13, "influence.split_at": 0.5}}"#), 200);
    let run = feed.run(3);
    assert!(run["problem"]["text"].as_str().is_some_and(|text| text.contains("split_at")), "{}", run["problem"]);
    feed.next("frames", |message| message["number"] == 3);
    let file = page.dir.path().join("read.rrd");
    std::fs::write(&file, page.get("first/3.rrd").2).unwrap();
    let recorded = Recorded::open(&file).expect("a recording");
    assert!(matches!(replay::verify(&recorded, |_| true), Ok(replay::Verdict::Identical)));
    assert_eq!(recorded.last(), 240);
}

/// A save has what was asked for when it was requested, however many follow.
#[test]
fn every_save_has_the_change_of_its_time() {
    let page = Page::two();
    let mut feed = page.feed();
    feed.next("frames", |_| true);
    for omega in [14, 20] {
        assert_eq!(page.post("change", &format!(r#"{{"values": {{"material.omega": {omega}}}}}"#)), 200);
        assert_eq!(page.post("save", r#"{"what": "scene"}"#), 204);
        assert_eq!(page.post("save", r#"{"what": "recording"}"#), 204);
    }
    feed.next("saved", |message| message["text"].as_str().is_some_and(|text| text.contains("page-2.rrd")));
    for (name, omega) in [("page", 14.0), ("page-2", 20.0)] {
        let scene = Scene::load(&page.dir.path().join(format!("{name}.toml"))).expect("a scene");
        assert_eq!(scene.bodies[0].material.omega, omega);
        assert!(page.dir.path().join(format!("{name}.rrd")).is_file());
    }
}

/// Whatever its name, a scene keeps the meshes that it came with.
#[test]
fn a_changed_scene_keeps_its_own_meshes() {
    let tetrahedron = "v 0 0 0\nv 3 0 0\nv 0 3 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
    let text = Scene::without_meshes(&Scene::builtin("mesh").expect("built in").source).to_owned();
    let dir = Dir::new();
    std::fs::write(dir.path().join("mesh.toml"), &text).unwrap();
    for file in ["knot.obj", "rock.obj", "block.obj", "star.obj"] {
        std::fs::write(dir.path().join(file), tetrahedron).unwrap();
    }
    let own = Scene::load(&dir.path().join("mesh.toml")).expect("a scene");
    let page = Page::open(&own.source);
    let mut feed = page.feed();
    feed.run(1);
    assert_eq!(page.post("change", r#"{"values": {"material.omega": 11}}"#), 200);
    feed.run(2);
    assert_eq!(page.post("save", r#"{"what": "scene"}"#), 204);
    feed.next("saved", |_| true);
    let saved = Scene::load(&page.dir.path().join("page.toml")).expect("a scene");
    assert_eq!(saved.vertex_count(), own.vertex_count());
    assert_ne!(saved.vertex_count(), Scene::builtin("mesh").unwrap().vertex_count());
    assert_eq!(saved.bodies[0].material.omega, 11.0);
}

/// A parameter that is gone has no thresholds, which is an answer.
#[test]
fn thresholds_of_what_is_unknown_are_none() {
    let page = Page::two();
    let mut feed = page.feed();
    feed.next("frames", |_| true);
    assert_eq!(page.post("thresholds", r#"{"key": "nonsense"}"#), 204);
    let marks = feed.next("marks", |message| message["key"] == "nonsense");
    assert!(marks["marks"].as_array().is_some_and(Vec::is_empty), "{marks}");
}

/// Neighbouring marks agree on the outcome between them.
#[test]
fn marks_leave_out_no_outcome_that_was_seen() {
    let page = Page::open(&Scene::builtin("collide").expect("built in").source);
    let mut feed = page.feed();
    feed.next("frames", |_| true);
    assert_eq!(page.post("thresholds", r#"{"key": "influence.alpha"}"#), 204);
    let marks = feed.next("marks", |_| true);
    let marks = marks["marks"].as_array().expect("marks");
    assert!(marks.len() > 2, "{marks:?}");
    for pair in marks.windows(2) {
        assert_eq!(pair[0]["above"], pair[1]["below"], "{marks:?}");
    }
}

/// Counts how often a scene is varied.
#[derive(Debug)]
struct Counted {
    run: SceneRun,
    count: Arc<AtomicUsize>,
}

impl Experiment for Counted {
    fn schema(&self) -> Schema {
        self.run.schema()
    }

    fn start(&self) -> Result<Box<dyn Simulation>, String> {
        self.run.start()
    }

    fn read(&self, name: &str, text: &str, run: &toml::Table) -> Result<Arc<dyn Experiment>, Refusal> {
        self.run.read(name, text, run)
    }

    fn parameters(&self) -> Vec<Parameter> {
        self.run.parameters()
    }

    fn varied(&self, variation: &Variation) -> Result<Arc<dyn Experiment>, InvalidVariation> {
        self.count.fetch_add(1, Ordering::Relaxed);
        self.run.varied(variation)
    }
}

/// Where nearly every run has another outcome, the search ends all the same, at its limit on runs.
#[test]
fn thresholds_of_a_chaotic_scene_take_few_runs() {
    let body = |k: i32| {
        format!(
            "[[body]]\nname = 'b{k}'\nradius = 0.5\nshape = {{ sphere = {{ stacks = 3, slices = 4 }} }}\nmotion = {{ free = {{ from = [{}, \
             {}, 0], velocity = [{}, 0.3, 0] }} }}\n",
            1.1 * f64::from(k),
            0.3 * f64::from(k * k % 3),
            1.5 - f64::from(k)
        )
    };
    let bodies: String = (0..4).map(body).collect();
    let count = Arc::<AtomicUsize>::default();
    let text = format!("duration = 4.0\ntolerance = 1e-2\n{bodies}");
    let page = Page::of(&text, |run| Arc::new(Counted { run, count: Arc::clone(&count) }));
    let mut feed = page.feed();
    feed.next("frames", |_| true);
    count.store(0, Ordering::Relaxed);
    assert_eq!(page.post("thresholds", r#"{"key": "influence.alpha"}"#), 204);
    feed.next("marks", |_| true);
    assert_eq!(count.load(Ordering::Relaxed), 256);
}

/// What is wrong with a watched file stays on the page until it is mended, beside the run that was going on and later ones.
#[test]
fn a_problem_of_the_file_stays_beside_runs() {
    let page = Page::open(&Scene::builtin("crowd").expect("built in").source);
    let mut feed = page.feed();
    feed.next("open", |message| message["number"] == 1);
    page.live.report(meldscope::live::change::Problem::new("the file is broken"));
    let measured = feed.next("run", |message| message["is_measured"] == true);
    assert_eq!(measured["problem"]["text"], "the file is broken");
    assert_eq!(page.post("change", r#"{"values": {"influence.alpha": 7}}"#), 200);
    assert_eq!(feed.run(2)["problem"]["text"], "the file is broken");
    let scene = Scene::builtin("two").unwrap();
    page.live.replace(Arc::new(SceneRun { scene, options: sim::Options::default() }));
    assert!(feed.run(3)["problem"].is_null());
}

/// A run of a scene that has been replaced does not stand in for an invalid change of the new one.
#[test]
fn an_unfinished_run_of_another_scene_is_not_made_again() {
    let page = Page::open(&Scene::builtin("crowd").expect("built in").source);
    let mut feed = page.feed();
    assert_eq!(page.post("change", r#"{"values": {"influence.merge_at": 1.14}}"#), 200);
    feed.next("open", |message| message["number"] == 2);
    let text = Scene::builtin("two").unwrap().source.replace("split_at = 1.2", "split_at = 1.1");
    let scene = Scene::parse(&text, "page.toml").expect("a scene");
    page.live.replace(Arc::new(SceneRun { scene, options: sim::Options::default() }));
    feed.next("problem", |message| message["text"].as_str().is_some_and(|text| text.contains("split_at")));
    assert_eq!(page.post("change", r#"{"values": {}}"#), 200);
    let next = feed.next("run", |message| message["number"].as_u64() > Some(2));
    assert_eq!(next["number"], 4);
}

#[test]
fn of_many_changes_the_last_is_answered() {
    let page = Page::two();
    let mut feed = page.feed();
    for k in 0..100 {
        assert_eq!(page.post("change", &format!(r#"{{"values": {{"influence.alpha": {k}}}, "cursor": {k}}}"#)), 200);
    }
    feed.next("frames", |message| message["number"] == 101);
    assert_eq!(page.get("runs/101.rrd").0, 200);
    // few of the hundred may have begun
    for number in 102..105 {
        assert_eq!(page.post("change", &format!(r#"{{"values": {{"influence.alpha": {number}}}}}"#)), 200);
        feed.next("frames", |message| message["number"] == number);
    }
    assert_eq!(page.get("runs/1.rrd").0, 404, "old runs are taken away");
}

#[test]
fn thresholds_of_a_parameter_are_found() {
    let page = Page::two();
    let mut feed = page.feed();
    feed.next("frames", |_| true);
    assert_eq!(page.post("thresholds", r#"{"key": "influence.merge_at"}"#), 204);
    let marks = feed.next("marks", |_| true);
    let mark = &marks["marks"].as_array().expect("marks")[0];
    // below the smallest q of their paths, the bodies never merge
    let mut world = World::new(Scene::builtin("two").unwrap()).unwrap();
    let mut least = f64::INFINITY;
    for _ in 0..world.scene().steps() {
        let _ = world.step();
        world.pairs().for_each(|pair| least = least.min(pair.q));
    }
    assert!((mark["value"].as_f64().unwrap() - least).abs() < 1e-3, "{mark} {least}");
    assert_eq!(mark["below"], "no event");
}

#[test]
fn what_is_saved_replaces_nothing_and_replays() {
    let page = Page::two();
    let mut feed = page.feed();
    assert_eq!(page.post("change", r#"{"values": {"influence.merge_at": 0.99}}"#), 200);
    feed.next("frames", |message| message["number"] == 2);
    for name in ["page", "page-2"] {
        let path = |extension: &str| page.dir.path().join(format!("{name}.{extension}"));
        for (what, extension) in [("scene", "toml"), ("recording", "rrd")] {
            assert_eq!(page.post("save", &format!(r#"{{"what": "{what}"}}"#)), 204);
            feed.next("saved", |message| {
                message["text"].as_str().is_some_and(|text| text.contains(&format!("{name}.{extension}")))
            });
        }
        let scene = Scene::load(&path("toml")).expect("a scene");
        assert_eq!(scene.thresholds.merge_at, 0.99);
        let recorded = Recorded::open(&path("rrd")).expect("a recording");
        assert!(matches!(replay::verify(&recorded, |_| true), Ok(replay::Verdict::Identical)));
    }
}

/// A branch is an `[[edit]]` of the saved scene and a force point a `[[point]]`, and the recording replays.
#[test]
fn branches_and_force_points_become_parts_of_the_scene() {
    let page = Page::two();
    let mut feed = page.feed();
    let merged = time(&feed.run(1), "merge a~b");
    let change = r#"{"values": {"influence.alpha": 150},
        "branches": [{"time": 1.9, "values": {"influence.split_at": 1.06, "influence.merge_at": 1.0}}],
        "poke": {"body": "b", "at": [2.5, -1.2, 0], "radius": 0.6, "strength": -80}, "cursor": 120}"#;
    assert_eq!(page.post("change", change), 200);
    let run = feed.run(2);
    assert_eq!(time(&run, "merge a~b"), merged);
    let split = time(&run, "split a~b");
    assert!(split < 3.0, "{split}");
    for (what, extension) in [("scene", "toml"), ("recording", "rrd")] {
        assert_eq!(page.post("save", &format!(r#"{{"what": "{what}"}}"#)), 204);
        feed.next("saved", |message| message["text"].as_str().is_some_and(|text| text.contains(extension)));
    }
    let scene = Scene::load(&page.dir.path().join("page.toml")).expect("a scene");
    assert_eq!((scene.edits[0].time, scene.edits[0].set.len()), (1.9, 2));
    assert_eq!((scene.points[0].strength, scene.points[0].bodies.as_deref()), (-80.0, Some(&[1][..])));
    let recorded = Recorded::open(&page.dir.path().join("page.rrd")).expect("a recording");
    assert!(matches!(replay::verify(&recorded, |_| true), Ok(replay::Verdict::Identical)));

    let wrong = r#"{"branches": [{"time": 1.0, "values": {"influence.merge_at": 1.3}}]}"#;
    assert_eq!(page.post("change", wrong), 200);
    let problem = feed.next("problem", |_| true);
    assert_eq!(problem["key"], "influence.merge_at", "{problem}");
    assert!(problem["text"].as_str().is_some_and(|text| text.contains("merge_at (1.3)")), "{problem}");
}

#[test]
fn only_who_knows_the_address_gets_the_page() {
    let page = Page::two();
    let (status, head, body) = page.get("");
    assert_eq!(status, 200);
    assert!(head.contains("content-security-policy: default-src 'none'"), "{head}");
    assert!(String::from_utf8(body).unwrap().contains("id=\"events\""));
    for path in ["live.js", "live.css", "favicon.ico", "re_viewer.js"] {
        assert_eq!(page.get(path).0, 200, "{path}");
    }
    assert_eq!(page.get("../Cargo.toml").0, 404);
    for line in ["GET /", "GET /live.js", "POST /change", "GET /0000/feed"] {
        assert_eq!(page.ask(line, "host: localhost\r\n", "").0, 404, "{line}");
    }
    let line = format!("GET {}/", page.path);
    assert_eq!(page.ask(&line, "host: evil.example\r\n", "").0, 403);
    assert_eq!(page.ask(&line, "host: localhost\r\norigin: http://evil.example\r\n", "").0, 403);
    assert_eq!(page.ask(&format!("PUT {}/", page.path), "host: localhost\r\n", "").0, 405);
}

#[test]
fn another_scene_keeps_the_changes_that_it_knows() {
    let page = Page::two();
    let mut feed = page.feed();
    assert_eq!(page.post("change", r#"{"values": {"influence.alpha": 7, "body.b.omega": 9}}"#), 200);
    feed.run(2);
    let text = Scene::builtin("two").unwrap().source.replace("name = \"b\"", "name = \"c\"");
    let scene = Scene::parse(&text, "page.toml").expect("a scene");
    page.live.replace(Arc::new(SceneRun { scene, options: sim::Options::default() }));
    let changes = feed.next("changes", |message| message["values"].get("body.b.omega").is_none());
    assert_eq!(changes["values"]["influence.alpha"], 7.0);
    time(&feed.run(3), "merge a~c");
}
