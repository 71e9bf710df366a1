// The page of `meldscope live`: sliders that change the scene, the run that answers, and the Rerun viewer that shows it.
//
// Every change is sent to the server, which runs the whole scene anew. It answers over the feed, first with the events and
// curves of the run, and then with the run itself, which the viewer reads from `runs/NUMBER.rrd`.
"use strict";

const $ = (id) => document.getElementById(id);
const NARROW = { top: "Hidden", blueprint: "Hidden", selection: "Hidden", time: "Hidden" };

let scene = null; // name, dt, steps, parameters, legend, bodies
let run = null; // the run on screen: number, events, plots
let before = null; // the run that it is compared with
let base = null; // the run before a slider was dragged, until its last run is here
let isDragging = false;
let pinned = null; // the run that the user pinned
let cursor = 0; // step
let playing = false;
let values = new Map(); // changed values by key
let branches = []; // [{ time, values: Map }] in order of time: values from an instant on, each an [[edit]] of the scene
let branch = null; // the one of them that changes go to
let poke = null; // { body, at, radius, strength }: a force point
let asked = 0; // number of the run that answers the newest change

// What this page asked for comes back over the feed, when it has moved on.
const page = crypto.getRandomValues(new Uint32Array(2)).join("-");

// ---------------------------------------------------------------------------------------------------------------- server

// The viewer would report its use to its makers. The server's content security policy forbids that; here it is not even
// tried.
const fetchAnything = window.fetch;
window.fetch = (request, options) => {
  const url = new URL(request.url ?? request, location);
  const isOwn = url.origin === location.origin || ["data:", "blob:"].includes(url.protocol);
  return isOwn ? fetchAnything(request, options) : Promise.reject(new TypeError(`${url.origin} is not on this machine`));
};

// Labels are too pale to read in the viewer's light theme. Its option `theme` has no effect, but it asks for the system's.
const systemMedia = window.matchMedia.bind(window);
const always = { "(prefers-color-scheme: dark)": "all", "(prefers-color-scheme: light)": "not all" };
window.matchMedia = (query) => systemMedia(always[query] ?? query);

// The answer, if there is one; a problem is shown.
async function post(path, body) {
  try {
    const response = await fetch(path, { method: "POST", body: JSON.stringify(body), headers: { "content-type": "application/json" } });
    if (response.status === 200) return await response.json();
    if (!response.ok) showProblem(await response.json().catch(() => ({ text: response.statusText })));
  } catch (error) {
    showProblem({ text: `the program does not answer: ${error.message}` });
  }
  return null;
}

let isSending = false;
let isStale = false;

// Sends the current values. While a change is on its way, later ones wait, and only the last of them is sent. Thresholds
// are those beside the other values: of all parameters but the one that moves, they are outdated.
async function send(moved) {
  isStale = true;
  clearMarks(moved);
  showChanges();
  if (isSending) return;
  isSending = true;
  while (isStale) {
    isStale = false;
    const later = branches.filter(({ values }) => values.size > 0).map(({ time, values }) => ({ time, values: Object.fromEntries(values) }));
    asked = (await post("change", { page, values: Object.fromEntries(values), branches: later, poke, cursor }))?.number ?? asked;
  }
  isSending = false;
  settle();
}

function listen() {
  const feed = new EventSource("feed");
  feed.onmessage = ({ data }) => {
    const message = JSON.parse(data);
    handlers[message.kind]?.(message);
  };
  feed.onerror = () => {
    document.body.classList.add("ended");
    say("the program has ended, or does not answer");
  };
  feed.onopen = () => document.body.classList.remove("ended");
}

const handlers = {
  scene(message) {
    // curves of runs with other steps would be at other times
    if (scene && (scene.dt !== message.dt || scene.steps !== message.steps)) {
      if (pinned) $("pin").click();
      before = base = run = null;
      for (const old of ["events", "plot"]) $(old).replaceChildren();
    }
    scene = message;
    cursor = Math.min(cursor, message.steps);
    poke = message.bodies.some(({ name }) => name === poke?.body) ? poke : null;
    $("scene").textContent = message.name;
    document.title = `${message.name} – meldscope live`;
    $("cursor").max = message.steps;
    showSliders();
    showLegend();
    showChanges();
    showPlot();
    showCursor();
    viewer.needsLayout = true;
  },
  // the change of another page, or what is left of this one's for another scene
  changes(message) {
    if (message.page === page) return;
    values = new Map(Object.entries(message.values));
    branches = message.branches.map(({ time, values }) => ({ time, values: new Map(Object.entries(values)) }));
    branch = null;
    poke = message.poke;
    showSliders();
    showChanges();
  },
  run(message) {
    if (run && message.number < run.number) return;
    if (message.number !== run?.number) {
      before = message.is_repeated ? before : (pinned ?? base ?? run);
    }
    else if (pinned?.number === run.number) pinned = before = message; // the same run again, with what its surfaces do
    run = message;
    settle();
    say(`run ${message.number}: ${message.outcome}; simulated in ${message.simulated_ms.toFixed(1)} ms${warned()}`);
    showProblem(message.problem ?? mistyped, message.failed);
    showEvents();
    showPlot();
  },
  open: ({ number }) => viewer.open(number),
  progress({ number, doing, step, steps }) {
    say(`run ${number}: ${doing}, step ${step} of ${steps}`);
  },
  frames(message) {
    if (run?.number !== message.number) return;
    const which = message.every > 1 ? `, lately every ${message.every} steps` : "";
    say(`run ${message.number}: ${run.outcome}; simulated in ${run.simulated_ms.toFixed(1)} ms, ${message.frames} frames in ${message.ms.toFixed(0)} ms${which}${warned()}`);
  },
  marks: ({ number, key, marks }) => number >= asked && !isSending && !branch && showMarks(key, marks),
  problem: (problem) => showProblem(problem),
  saved: ({ text }) => ($("saved").textContent = text),
};

// What is valid but probably not intended in the scene of the run on screen.
const warned = () => run.warnings.map((warning) => `; warning: ${warning}`).join("");

function say(text) {
  $("status").textContent = text;
}

let mistyped = null; // what is wrong with the text of a field

// Unless the problem is that of the run on screen, this is not the run of the values that are shown.
function showProblem(problem, isOfRun = false) {
  for (const wrong of document.querySelectorAll(".parameter.wrong")) wrong.classList.remove("wrong");
  $("message").textContent = problem ? problem.text : "";
  document.body.classList.toggle("stale", Boolean(problem) && !isOfRun);
  if (problem?.key) parameterOf(problem.key)?.row.classList.add("wrong");
}

// ---------------------------------------------------------------------------------------------------------------- sliders

const rows = new Map(); // the elements of each parameter by key

const parameterOf = (key) => rows.get(key);
const shown = (value) => String(Number(value.toPrecision(6)));

// The value that a slider shows: from the branch's instant on, if changes go to one; else at the start.
function valueOf(parameter) {
  const until = branch?.time ?? -Infinity;
  const last = branches.findLast(({ time, values }) => time <= until && values.has(parameter.key));
  return last?.values.get(parameter.key) ?? values.get(parameter.key) ?? parameter.value;
}

function change(parameter, value) {
  if (mistyped?.key === parameter.key) mistyped = null;
  if (branch && parameter.can_branch) {
    branch.values.delete(parameter.key);
    if (value !== valueOf(parameter)) branch.values.set(parameter.key, value);
  } else if (value === parameter.value) values.delete(parameter.key);
  else values.set(parameter.key, value);
  rows.get(parameter.key).show();
  send(branch ? undefined : parameter.key);
}

function clearMarks(except) {
  for (const [key, { marks }] of rows) if (key !== except) marks.replaceChildren();
}

function showSliders() {
  mistyped = null;
  const groups = new Map();
  for (const parameter of scene.parameters) {
    if (!groups.has(parameter.group)) groups.set(parameter.group, []);
    groups.get(parameter.group).push(parameter);
  }
  const open = new Set([...document.querySelectorAll("#sliders details[open]")].map((details) => details.dataset.group));
  rows.clear();
  const listed = [...groups.keys()].filter((group) => group.startsWith("body ")).length;
  const count = scene.bodies.length;
  $("sliders").replaceChildren(
    ...[...groups].map(([group, parameters], index) => {
      const details = element("details", { open: open.has(group) || (open.size === 0 && index < 1) }, element("summary", {}, group), ...parameters.map(slider));
      details.dataset.group = group;
      return details;
    }),
    ...(0 < listed && listed < count ? [element("p", { className: "unit" }, `sliders for ${listed} of ${count} bodies`)] : []),
    ...(count > 0 ? [pokeSection(open)] : []),
  );
}

// A force point beside a body, and the sliders that move it.
function pokeSection(open) {
  const bodies = element("select", { ariaLabel: "body to poke" }, ...scene.bodies.map(({ name }) => element("option", {}, name)));
  const button = element("button", { id: "poke" }, poke ? "Remove" : "Poke");
  const fields = element("div", {});
  const number = (label, unit, [min, max], value, set) => {
    const track = element("input", { type: "range", min, max, step: "any", value, ariaLabel: label });
    track.dataset.key = `poke.${label}`;
    const exact = element("output", {}, shown(value));
    drags(track);
    track.addEventListener("input", () => {
      poke = { ...poke, ...set(Number(track.value)) };
      exact.textContent = shown(Number(track.value));
      send();
    });
    return element("div", { className: "parameter" }, element("label", {}, label, " ", element("span", { className: "unit" }, unit)), exact, element("div", { className: "track" }, track));
  };
  if (poke) {
    const { at, radius } = scene.bodies.find(({ name }) => name === poke.body);
    bodies.value = poke.body;
    const moved = (axis) => (value) => ({ at: poke.at.with(axis, value) });
    fields.append(
      number("strength", "1/s²; repels below 0", [-500, 500], poke.strength, (strength) => ({ strength })),
      number("radius", "scene unit", [0.1 * radius, 3 * radius], poke.radius, (radius) => ({ radius })),
      ...["x", "y", "z"].map((label, axis) => number(label, "scene unit", [at[axis] - 4 * radius, at[axis] + 4 * radius], poke.at[axis], moved(axis))),
    );
  }
  const place = () => {
    const { name, at, radius } = scene.bodies.find(({ name }) => name === bodies.value);
    poke = { body: name, at: [at[0], at[1] - 1.6 * radius, at[2]], radius, strength: -150 };
  };
  const again = () => {
    showSliders();
    send();
  };
  button.addEventListener("click", () => {
    if (poke) poke = null;
    else place();
    again();
  });
  bodies.addEventListener("change", () => {
    if (!poke) return;
    place();
    again();
  });
  const summary = element("summary", { title: "a force point that attracts or repels the vertices of one body" }, "poke");
  const details = element("details", { open: open.has("poke") || poke !== null }, summary, element("div", { className: "row" }, bodies, button), fields);
  details.dataset.group = "poke";
  return details;
}

// While a slider is dragged, runs are compared with that before.
function drags(track) {
  track.addEventListener("input", () => {
    if (!isDragging) base = run;
    isDragging = true;
  });
}
for (const end of ["change", "pointerup", "pointercancel", "blur"]) window.addEventListener(end, () => ((isDragging = false), settle()));

// Once the last run of a drag is here, the next is compared with it.
function settle() {
  if (!isDragging && !isSending && (run?.number ?? 0) >= asked) base = null;
}

function slider(parameter) {
  const track = element("input", { type: "range", min: parameter.min, max: parameter.max, step: "any", id: `value of ${parameter.key}` });
  track.dataset.key = parameter.key;
  const exact = element("input", { type: "text", inputMode: "decimal", ariaLabel: `${parameter.label}, exact` });
  const label = element("label", { htmlFor: track.id, title: `${parameter.key}: ${parameter.about}` }, parameter.label, " ", element("span", { className: "unit" }, parameter.unit));
  const marks = element("div", { className: "marks" });
  const reset = element("button", { className: "reset", title: `back to ${shown(parameter.value)}`, ariaLabel: `reset ${parameter.label}` }, "↺");
  const row = element("div", { className: "parameter" }, label, reset, exact, element("div", { className: "track" }, track, marks));
  const show = () => {
    const value = valueOf(parameter);
    track.value = value;
    if (document.activeElement !== exact) {
      exact.value = shown(value);
      if (mistyped?.key === parameter.key) mistyped = null;
    }
    row.classList.toggle("changed", value !== parameter.value);
  };
  drags(track);
  track.addEventListener("input", () => change(parameter, Number(track.value)));
  track.addEventListener("change", () => branch || post("thresholds", { key: parameter.key }));
  exact.addEventListener("change", () => {
    const value = Number(exact.value.trim());
    if (exact.value.trim() === "" || !Number.isFinite(value)) {
      mistyped = { key: parameter.key, text: `${parameter.key}: "${exact.value}" is not a number` };
      return showProblem(mistyped);
    }
    change(parameter, value);
  });
  reset.addEventListener("click", () => change(parameter, parameter.value));
  rows.set(parameter.key, { row, marks, parameter, show });
  show();
  return row;
}

// Values at which the outcome of the run changes, as marks on the track.
function showMarks(key, marks) {
  const known = parameterOf(key);
  known?.marks.replaceChildren(
    ...marks.map(({ value, below, above }) => {
      // found to 1e-4 of the range
      const digits = Math.ceil(-Math.log10(1e-4 * (known.parameter.max - known.parameter.min)));
      const mark = element("i", { title: `at ${value.toFixed(Math.min(Math.max(digits, 0), 20))} the outcome changes: ${below} | ${above}` });
      mark.style.left = `${(100 * (value - known.parameter.min)) / (known.parameter.max - known.parameter.min)}%`;
      return mark;
    }),
  );
}

function showLegend() {
  $("legend").replaceChildren(
    ...scene.legend.map(({ label, color, is_arrow }) => {
      const sign = element("i", {}, is_arrow ? "→" : "○");
      sign.style.color = color;
      return element("span", {}, sign, ` ${label}`);
    }),
  );
}

// ---------------------------------------------------------------------------------------------------------------- changes

// The changed values as tables of a scene file. A vector is written whole.
function asToml() {
  const tables = new Map();
  const vectors = new Set();
  for (const [key, value] of values) {
    const { group } = rows.get(key)?.parameter ?? { group: "" };
    const [, whole, component] = key.match(/^(.*?)(\[\d+\])?$/);
    if (component && vectors.has(whole)) continue;
    if (component) vectors.add(whole);
    const path = whole.replace(/\.?[^.]*$/, "");
    // an item of an array by its name or number, and the path inside it
    const item = path.match(/^([^.[]+)(\[\d+\]|\.[^.]+)/);
    const table = item ? item[0] : path;
    const name = whole.slice(table.length).replace(/^\./, "");
    if (!tables.has(table)) tables.set(table, [table === "" ? "" : item ? `[[${item[1]}]]  # ${group}` : `[${path}]`]);
    const of = (axis) => values.get(`${whole}[${axis}]`) ?? rows.get(`${whole}[${axis}]`)?.parameter.value ?? 0;
    tables.get(table).push(`${name} = ${component ? `[${[0, 1, 2].map(of).join(", ")}]` : value}`);
  }
  // keys without a table are at the top of a scene
  const sorted = [...tables].sort(([one], [other]) => Number(one !== "") - Number(other !== ""));
  const changed = sorted.map(([, lines]) => lines.filter((line) => line !== "").join("\n"));
  if (poke) {
    const [act, name] = poke.strength < 0 ? ["repel", "beta"] : ["attract", "alpha"];
    changed.push(`[[point]]\nname = "poke"\nmotion = { fixed = [${poke.at.join(", ")}] }\nradius = ${poke.radius}\nact = "${act}"\n${name} = ${Math.abs(poke.strength)}\nbodies = ["${poke.body}"]`);
  }
  for (const { time, values } of branches) {
    if (values.size > 0) changed.push(`[[edit]]\ntime = ${time}\nset = { ${[...values].map(([key, value]) => `"${key}" = ${value}`).join(", ")} }`);
  }
  return changed.join("\n\n");
}

function showChanges() {
  $("toml").textContent = asToml();
  $("flags").textContent = [...values].map(([key, value]) => `--set ${key}=${value}`).join(" ");
  $("unflagged").hidden = poke === null && branches.every(({ values }) => values.size === 0);
  $("reset").disabled = values.size === 0 && branches.length === 0 && poke === null;
  $("branches").replaceChildren(
    ...branches.map((one) => {
      const remove = element("button", { title: "remove this branch", ariaLabel: "remove this branch" }, "✕");
      remove.addEventListener("click", () => {
        branches = branches.filter((other) => other !== one);
        if (branch === one) branch = null;
        showAll();
        send();
      });
      return element("li", {}, `from ${one.time.toFixed(4)} s: ${one.values.size} changed `, remove);
    }),
  );
  $("branch").setAttribute("aria-pressed", String(branch !== null));
  $("branch").textContent = branch ? `Changing from ${branch.time.toFixed(4)} s on` : "Branch here";
}

function showAll() {
  for (const { show } of rows.values()) show();
  showChanges();
}

$("branch").addEventListener("click", () => {
  if (!scene) return;
  branches = branches.filter(({ values }) => values.size > 0);
  if (branch) branch = null;
  else {
    const time = cursor * scene.dt;
    branch = branches.find((one) => one.time === time) ?? { time, values: new Map() };
    if (!branches.includes(branch)) branches.push(branch);
    branches.sort((one, other) => one.time - other.time);
  }
  clearMarks();
  showAll();
});

$("reset").addEventListener("click", () => {
  values = new Map();
  branches = [];
  branch = null;
  poke = null;
  showSliders();
  send();
});

// The server saves the change that it knows: the last one may still be on its way.
async function save(what) {
  while (isSending) await new Promise((resolve) => setTimeout(resolve, 10));
  const isInvalid = document.querySelector(".parameter.wrong");
  $("saved").textContent = isInvalid ? "not saved: the marked value is invalid" : "";
  if (isInvalid) return;
  await post("save", { what });
}
for (const what of ["scene", "recording"]) $(`save-${what}`).addEventListener("click", () => save(what));

$("pin").addEventListener("click", () => {
  if (!run) return;
  pinned = pinned ? null : run;
  before = pinned;
  $("pin").textContent = pinned ? "Unpin" : "Pin this run";
  $("pin").setAttribute("aria-pressed", String(pinned !== null));
  showEvents();
  showPlot();
});

// ---------------------------------------------------------------------------------------------------------------- events

// Events of two runs correspond if they have the same name, in the order of time. Those of surfaces are compared once both
// runs have them.
function matched() {
  const areMeasured = run.is_measured && before?.is_measured;
  const counts = new Map();
  const keyed = (events) => events.map((event) => {
    const count = counts.get(event.event) ?? 0;
    counts.set(event.event, count + 1);
    return [`${event.event} ${count}`, event];
  });
  const now = keyed(run.events);
  counts.clear();
  const then = new Map(before && before !== run ? keyed(before.events.filter((event) => areMeasured || !event.is_contact)) : []);
  const rows = now.map(([key, event]) => {
    const old = then.get(key);
    then.delete(key);
    return { event, old, isCompared: areMeasured || !event.is_contact };
  });
  return [...rows, ...[...then.values()].map((event) => ({ event, isGone: true }))].sort((a, b) => a.event.time - b.event.time);
}

function differenceOf({ event, old, isCompared, isGone }) {
  if (!before || before === run) return ["", ""];
  if (isGone) return ["gone", event.time > 0.9 * scene.steps * scene.dt ? "gone, or after the end" : "gone"];
  if (!isCompared) return ["", ""];
  if (!old) return ["new", "new"];
  const by = event.time - old.time;
  if (Math.abs(by) < 5e-7) return ["", "same"];
  const size = Math.abs(by) < 0.01 ? `${(1000 * Math.abs(by)).toPrecision(3)} ms` : `${Math.abs(by).toFixed(3)} s`;
  return by < 0 ? ["earlier", `${size} earlier`] : ["later", `${size} later`];
}

function showEvents() {
  $("against").textContent = pinned ? `against run ${pinned.number} (pinned)` : before ? `against run ${before.number}` : "";
  const left = run.event_count - run.events.length;
  $("more").textContent = left > 0 ? `and ${left} more events after these` : "";
  $("events").replaceChildren(
    ...matched().map((row) => {
      const [kind, words] = differenceOf(row);
      const line = element("tr", { className: row.isGone ? "gone" : "", title: row.event.text }, element("td", {}, row.event.event), element("td", {}, `${row.event.time.toFixed(4)} s`), element("td", { className: kind }, words));
      line.dataset.event = row.event.event;
      line.dataset.time = row.event.time;
      line.dataset.step = row.event.step;
      line.addEventListener("click", () => seek(row.event.step));
      return line;
    }),
  );
  markCurrent();
}

function markCurrent() {
  for (const line of $("events").children) line.classList.toggle("current", Number(line.dataset.step) === cursor);
}

// ---------------------------------------------------------------------------------------------------------------- plot

const SVG = "http://www.w3.org/2000/svg";
const [LEFT, RIGHT] = [34, 8]; // margins
const COLORS = ["#4da3ff", "#6cc24a", "#e07ab8", "#b7a34b", "#48b8b0", "#c98a5a", "#9a8cff", "#8fb35c"];

function showPlot() {
  if (!run || !scene) return;
  const plot = $("plot");
  const { width, height } = plot.getBoundingClientRect();
  const [left, right, top, bottom] = [LEFT, RIGHT, 8, 18];
  const all = [...run.plots, ...(before && before !== run ? before.plots : [])];
  const numbers = [...all.flatMap((line) => line.q.filter((q) => q !== null)), ...run.levels.flatMap(({ lines }) => lines.map(([, q]) => q).filter((q) => q !== null))];
  if (numbers.length === 0) return plot.replaceChildren(draw("text", { x: left, y: height / 2 }, "no pair comes within reach"));
  const least = Math.min(...numbers), most = Math.max(...numbers);
  const room = 0.06 * (most - least || 1);
  const [low, high] = [Math.max(0, least - room), most + room];
  const x = (step) => left + ((width - left - right) * step) / Math.max(1, scene.steps);
  const y = (q) => height - bottom - ((height - top - bottom) * (q - low)) / (high - low);
  plot.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const path = (line) => {
    let d = "", isDown = false;
    line.q.forEach((q, index) => {
      if (q !== null) d += `${isDown ? "L" : "M"}${x(index * line.every).toFixed(1)} ${y(q).toFixed(1)}`;
      isDown = q !== null;
    });
    return d;
  };
  const parts = [];
  for (const q of ticks(low, high, 4)) parts.push(draw("line", { class: "grid", x1: left, x2: width - right, y1: y(q), y2: y(q) }), draw("text", { x: left - 4, y: y(q) + 3, "text-anchor": "end" }, shown(q)));
  for (const t of ticks(0, scene.steps * scene.dt, 6)) parts.push(draw("text", { x: x(t / scene.dt), y: height - 5, "text-anchor": "middle" }, `${shown(t)} s`));
  const labelled = [];
  for (const { label, lines, color } of run.levels.slice(0, 12)) {
    // an edit changes it from a step on
    lines.forEach(([step, q], index) => {
      if (q === null) return;
      const end = x(lines[index + 1]?.[0] ?? scene.steps);
      parts.push(draw("line", { class: "threshold", x1: x(step), x2: end, y1: y(q), y2: y(q), stroke: color }));
      const beside = labelled.filter(([x, at]) => x === end && Math.abs(at - y(q)) < 11).length;
      labelled.push([end, y(q)]);
      parts.push(draw("text", { x: end - 2 - 90 * beside, y: y(q) - 3, "text-anchor": "end", fill: color }, `${label} ${shown(q)}`));
    });
  }
  for (const { time } of branches) parts.push(draw("line", { class: "plotted-branch", x1: x(time / scene.dt), x2: x(time / scene.dt), y1: top, y2: height - bottom }));
  if (before && before !== run) for (const line of before.plots) parts.push(draw("path", { class: "before", d: path(line) }));
  run.plots.forEach((line, index) => {
    const color = COLORS[index % COLORS.length];
    const curve = draw("path", { class: "q", d: path(line), stroke: color });
    curve.append(draw("title", {}, line.pair));
    parts.push(curve);
  });
  for (const event of run.events) {
    const line = run.plots.find((line) => line.pair === event.pair);
    if (line && event.q !== null) {
      const dot = draw("circle", { fill: event.color, cx: x(event.time / scene.dt), cy: y(event.q), r: 3.5 });
      dot.append(draw("title", {}, event.text));
      parts.push(dot);
    }
  }
  parts.push(draw("line", { class: "at", id: "at", x1: x(cursor), x2: x(cursor), y1: top, y2: height - bottom }));
  plot.replaceChildren(...parts);
  const pairs = run.plots.map((line, index) => [element("span", {}, line.pair), COLORS[index % COLORS.length]]);
  pairs.forEach(([name, color]) => (name.style.color = color));
  $("plot-title").replaceChildren("distance q of ", ...pairs.slice(0, 6).flatMap(([name], index) => (index ? [", ", name] : [name])), pairs.length > 6 ? ` and ${pairs.length - 6} more` : "", before && before !== run ? `; grey: run ${before.number}` : "");
}

function ticks(low, high, count) {
  const rough = (high - low) / count, decade = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * decade).find((step) => step >= rough);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(Number((k * step).toPrecision(9)));
  return found;
}

function scrub(event) {
  if (!run || (event.type === "pointermove" && event.buttons === 0)) return;
  const { x, width } = $("plot").getBoundingClientRect();
  seek(Math.round((scene.steps * (event.clientX - x - LEFT)) / (width - LEFT - RIGHT)));
}
$("plot").addEventListener("pointerdown", scrub);
$("plot").addEventListener("pointermove", scrub);
new ResizeObserver(showPlot).observe($("plot"));

// ---------------------------------------------------------------------------------------------------------------- time

function seek(step) {
  if (!scene) return;
  playing = false;
  cursor = Math.max(0, Math.min(scene.steps, step));
  showCursor();
  viewer.seek();
}

function showCursor() {
  if (!scene) return;
  $("cursor").value = cursor;
  $("now").textContent = `step ${cursor} · ${(cursor * scene.dt).toFixed(4)} s`;
  $("play").textContent = playing ? "pause" : "play";
  const at = $("at");
  if (at) {
    const { width } = $("plot").getBoundingClientRect();
    const x = LEFT + ((width - LEFT - RIGHT) * cursor) / Math.max(1, scene.steps);
    at.setAttribute("x1", x);
    at.setAttribute("x2", x);
  }
  markCurrent();
}

function seekEvent(direction) {
  const steps = (run?.events ?? []).map((event) => event.step);
  const found = direction > 0 ? steps.find((step) => step > cursor) : steps.findLast((step) => step < cursor);
  if (found !== undefined) seek(found);
}

function toggle() {
  playing = !playing;
  if (playing && cursor >= scene.steps) cursor = 0;
  viewer.seek();
  showCursor();
}

$("step-back").addEventListener("click", () => seek(cursor - 1));
$("step-on").addEventListener("click", () => seek(cursor + 1));
$("event-back").addEventListener("click", () => seekEvent(-1));
$("event-on").addEventListener("click", () => seekEvent(1));
$("play").addEventListener("click", toggle);
$("cursor").addEventListener("input", () => seek(Number($("cursor").value)));
document.addEventListener("keydown", (event) => {
  const isModified = event.ctrlKey || event.altKey || event.metaKey;
  const isTheirs = event.target.matches("input, select") || (event.key === " " && event.target.matches("button, summary"));
  if (!scene || isModified || isTheirs) return;
  const move = { ArrowLeft: () => (event.shiftKey ? seekEvent(-1) : seek(cursor - 1)), ArrowRight: () => (event.shiftKey ? seekEvent(1) : seek(cursor + 1)), " ": toggle, Home: () => seek(0), End: () => seek(scene.steps) }[event.key];
  if (move) {
    event.preventDefault();
    event.stopPropagation();
    move();
  }
}, true);

// ---------------------------------------------------------------------------------------------------------------- viewer

// The viewer shows one run. A new run is opened as soon as the one before is on screen, and then that one is closed: so a
// fast drag opens few runs, and the last one always.
const viewer = {
  handle: null,
  shown: null, // { number, url, recording }
  opening: null, // { number, url }
  wanted: null, // number
  needsLayout: true,

  async start() {
    const response = await fetch("re_viewer_bg.wasm");
    const size = Number(response.headers.get("content-length"));
    let loaded = 0;
    const count = new TransformStream({
      transform(part, to) {
        loaded += part.byteLength;
        $("loading").textContent = `loading the viewer: ${Math.floor((100 * loaded) / size)} %`;
        to.enqueue(part);
      },
    });
    await wasm_bindgen(new Response(response.body.pipeThrough(count), { headers: response.headers }));
    const query = new URLSearchParams(location.search);
    const handle = new wasm_bindgen.WebHandle({
      url: [],
      render_backend: query.get("renderer"),
      hide_welcome_screen: true,
      enable_history: false,
      persist: false,
      panel_state_overrides: NARROW,
      on_viewer_event: (text) => this.event(JSON.parse(text)),
    });
    setInterval(() => handle.has_panicked() && ($("loading").textContent = `The viewer has crashed.\n${handle.panic_message()}`), 1000);
    await handle.start($("viewer"));
    // the viewer would keep the focus: Tab passes it by, and leaves it
    for (const trap of document.querySelectorAll("#view canvas, #view input")) trap.tabIndex = -1;
    window.addEventListener("keydown", (event) => event.key === "Tab" && event.stopImmediatePropagation(), true);
    $("loading").textContent = "";
    this.handle = handle;
    if (this.wanted !== null) this.open(this.wanted);
  },

  open(number) {
    this.wanted = number;
    if (!this.handle || this.opening) return;
    // the first run of a scene brings the layout; later ones leave it as the user has arranged it
    const bringsLayout = this.needsLayout;
    this.needsLayout = false;
    const url = new URL(`${bringsLayout ? "first" : "runs"}/${number}.rrd`, location).href;
    this.opening = { number, url, bringsLayout };
    this.handle.add_receiver(url);
    this.wait(performance.now());
  },

  // Waits until the viewer shows the run that is being opened.
  wait(since, woken = since) {
    const recording = this.handle.get_active_recording_id();
    if (recording?.startsWith(`${this.opening.number}-`)) return this.opened(recording);
    // a run that was replaced before it was read is never shown
    if (performance.now() - since > 1000 && this.wanted !== this.opening.number) {
      this.handle.remove_receiver(this.opening.url);
      this.needsLayout ||= this.opening.bringsLayout;
      this.opening = null;
      return this.open(this.wanted);
    }
    // it may sleep, and sees a new run only when it wakes
    if (performance.now() - woken > 200) {
      window.dispatchEvent(new Event("pageshow"));
      woken = performance.now();
    }
    setTimeout(() => this.wait(since, woken), 15);
  },

  opened(recording) {
    const last = this.shown;
    this.shown = { ...this.opening, recording };
    this.opening = null;
    if (last) this.handle.remove_receiver(last.url);
    this.seek();
    if (this.wanted !== this.shown.number) this.open(this.wanted);
  },

  // Moves the viewer's cursor, again until the viewer has read enough of the run to follow.
  seek(since = performance.now()) {
    const recording = this.shown?.recording;
    if (!recording) return;
    clearTimeout(this.seeking);
    this.handle.set_active_timeline(recording, "step");
    this.handle.set_playing(recording, playing);
    this.handle.set_time_for_timeline(recording, "step", cursor);
    const is_there = this.handle.get_active_timeline(recording) === "step" && this.handle.get_time_for_timeline(recording, "step") === cursor;
    if (!playing && !is_there && performance.now() - since < 20000) this.seeking = setTimeout(() => this.seek(since), 30);
  },

  event(event) {
    if (event.type === "time_update" && this.shown && event.recording_id === this.shown.recording && playing) {
      cursor = Math.max(0, Math.min(scene.steps, Math.floor(event.time)));
      showCursor();
    }
  },
};

// ---------------------------------------------------------------------------------------------------------------- elements

function element(name, properties, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

function draw(name, attributes, ...children) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

listen();
viewer.start().catch((error) => ($("loading").textContent = `The viewer does not start: ${error}\nTry ?renderer=webgl or ?renderer=webgpu.`));
