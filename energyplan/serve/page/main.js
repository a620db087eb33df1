// The page: what is asked of the service when something on it changes, and how it is shown.

import { get, post, upload } from "./api.js";
import { Chart } from "./chart.js";

const $ = (id) => document.getElementById(id);
const scene = $("scene");
const status = $("status");
let start = null, goal = null, tasks = [], mode = "route", asked = null, plot = null;

const chart = new Chart("map", place);

function say(text, bad = false) {
  status.textContent = text;
  status.classList.toggle("bad", bad);
}

// -- small pieces of HTML: text is always set as text ------------------------------------------

function element(tag, text = "", name = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  made.className = name;
  return made;
}

function table(header, rows) {
  const made = element("table");
  const line = (tag, cells) => {
    const row = element("tr");
    for (const cell of cells) {
      const [text, name] = Array.isArray(cell) ? cell : [cell, ""];
      row.append(element(tag, text, name));
    }
    return row;
  };
  made.append(line("th", header), ...rows.map((cells) => line("td", cells)));
  return made;
}

const raised = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴" };
const unit = (text) => text === "1" ? "" : ` ${text.replace(/\^([-\d]+)/g, (_, n) => [...n].map((c) => raised[c] ?? c).join(""))}`;
// Energies are in J up to that of a long drive, in Wh beyond.
const energy = (value) => value == null ? "–" : Math.abs(value) < 36000
  ? `${(Math.round(value) || 0).toLocaleString("en")} J` : `${(value / 3600).toPrecision(4)} Wh`;
const percent = (value) => `${(100 * value).toFixed(1)} %`;

// the scene

function options(select, names, none) {
  select.replaceChildren(...(none ? [new Option(none, "")] : []), ...names.map((n) => new Option(n, n)));
}

async function begin() {
  const files = await get("files");
  options(scene.map, files.maps);
  options(scene.surfaces, files.surfaces, "none");
  $("models").replaceChildren(...[...files.models, "quadriga:empty:concrete",
    "quadriga:empty:marble", "quadriga:full:concrete", "quadriga:full:marble"].map((n) => new Option(n)));
  if (!files.maps.length) return say("The data folder holds no map (a YAML file with its image).", true);
  await load();
}

async function load() {
  say("Loading the map…");
  const surfaces = scene.surfaces.value;
  const [grid, areas] = await Promise.all([
    get(`maps/${scene.map.value}`), surfaces ? get(`surfaces/${surfaces}`) : null,
  ]);
  reset();
  await chart.show(grid, areas);
  $("legend").replaceChildren(...[["least energy", "var(--least)"], ["shortest", "var(--short)"], ...chart.legend]
    .map(([name, tint]) => { const made = element("span", name, "tint"); made.style.borderColor = tint; return made; }));
}

function reset() {
  for (const marked of [start, goal, ...tasks]) marked?.remove();
  [start, goal, tasks] = [null, null, []];
  clearRoutes();
  $("verdicts").replaceChildren();
  $("charge").replaceChildren();
  say("Click on the map to place the start, or press Enter on it to place it in the middle.");
}

// What was said of the mission no longer holds where a task or the start was moved.
function stale() {
  if (!$("verdicts").childElementCount) return;
  for (const id of ["verdicts", "charge"]) $(id).classList.add("stale");
  for (const task of tasks) task.mark("");
  chart.routes.clearLayers();
  say("Poses have changed: ask again whether the battery lasts.");
}

function place(x, y) {
  if (!start) {
    start = chart.pose("S", [x, y, 0], () => { stale(); replan(); });
    say(mode === "route" ? "Now click where the goal is." : "Now click where tasks are.");
  } else if (mode === "mission") {
    tasks.push(chart.pose(String(tasks.length + 1), [x, y, 0], stale, "task"));
    stale();
    say(`${tasks.length} task${tasks.length > 1 ? "s" : ""}. Ask whether the battery lasts.`);
  } else if (!goal) {
    goal = chart.pose("G", [x, y, 0], replan);
    replan();
  }
}

// routes

async function replan() {
  if (!start || !goal || mode !== "route") return;
  asked?.abort();
  const mine = asked = new AbortController();
  say("Planning…");
  try {
    const told = await post("compare", {
      map: scene.map.value, model: scene.model.value, surfaces: scene.surfaces.value || null,
      start: start.pose, goal: goal.pose, time_limit: 0.3,
    }, mine.signal);
    if (mine !== asked) return;
    show(told);
  } catch (error) {
    if (error.name !== "AbortError") { clearRoutes(); say(error.message, true); }
  }
}

function clearRoutes() {
  chart.routes.clearLayers();
  chart.reach.clearLayers();
  $("answer").replaceChildren();
}

function show(told) {
  clearRoutes();
  if (told.path === null) return say(`No path: ${told.reason}`, true);
  const { energy_optimal: best, shortest } = told;
  chart.route(shortest.path, "--short", true);
  chart.route(best.path, "--least");
  say("Drag a marker to plan again.");
  const lead = element("p");
  // Saving, joules and terms are of one energy: that of driving with all stops, where there is one.
  const of = told.saving_of, parts = of === "energy" ? "breakdown" : "breakdown_driven";
  const kind = of === "energy" ? "energy at steady speeds" : "energy as driven, with its stops";
  const beyond = best.potential < 0 ? " beyond what the descent is worth" : "";
  lead.append(element("span", energy(best[of]), "big least"), ` least energy. That saves ${percent(told.saving)} of the shortest route's${beyond}.`);
  const terms = [...new Set([...Object.keys(best[parts]), ...Object.keys(shortest[parts])])];
  $("answer").replaceChildren(lead, table(
    ["", ["least energy", "least"], ["shortest", "short"]],
    [
      ...terms.map((name) => [name.replaceAll("_", " "), energy(best[parts][name] ?? 0), energy(shortest[parts][name] ?? 0)]),
      [kind, energy(best[of]), energy(shortest[of])],
      ["length", `${best.length.toFixed(1)} m`, `${shortest.length.toFixed(1)} m`],
      ["turning", `${(best.turning * 180 / Math.PI).toFixed(0)}°`, `${(shortest.turning * 180 / Math.PI).toFixed(0)}°`],
      ...(of === "energy" ? [] : [["energy at steady speeds", energy(best.energy), energy(shortest.energy)]]),
      ["no route takes less than, at steady speeds", energy(best.lower_bound), "–"],
    ],
  ));
}

// range

async function range() {
  if (!start) return say("Place the start on the map first.", true);
  const form = $("battery");
  const spread = form.spread.value / 100;
  say("Searching for all places in reach…");
  try {
    const told = await post("range", {
      map: scene.map.value, model: scene.model.value, surfaces: scene.surfaces.value || null,
      start: start.pose, back: $("back").checked ? start.pose : null, pack: form.preset.value,
      soc: form.soc.value / 100, reserve: form.reserve.value / 100,
      coefficient_spread: spread, confidence: spread > 0 ? 0.95 : null,
    });
    clearRoutes();
    chart.areas(told.areas, energy);
    const all = told.contours.at(-1);
    say(`${Math.round(all.area).toLocaleString("en")} m² are in reach${$("back").checked ? ", and back" : ""}${spread > 0 ? ", with 95 % confidence" : ""}.`);
    $("answer").replaceChildren(table(["with", "area in reach"],
      told.contours.map((line) => [energy(line.energy), `${Math.round(line.area).toLocaleString("en")} m²`])));
  } catch (error) { say(error.message, true); }
}

// missions

async function evaluate(event) {
  event.preventDefault();
  if (!start || !tasks.length) return say("Place the start and some tasks on the map first.", true);
  const form = $("battery");
  if (!form.reportValidity()) return null;
  const document_ = {
    model: scene.model.value, map: scene.map.value, battery: form.preset.value,
    soc: form.soc.value / 100, reserve: form.reserve.value / 100, order: "free",
    return_to: "start", start: start.pose, coefficient_spread: form.spread.value / 100,
    tasks: tasks.map((task, k) => ({
      name: `task ${k + 1}`, pose: task.pose, dwell: 60 * form.dwell.value,
      power: Number(form.power.value), required: false,
    })),
  };
  if (scene.surfaces.value) document_.surfaces = scene.surfaces.value;
  const power = Number(form.charger.value);
  if (power) document_.chargers = [{ name: "charger", pose: start.pose, power }];
  say("Evaluating the mission…");
  try {
    const told = await post("mission", { document: document_ });
    verdicts(told);
  } catch (error) { say(error.message, true); }
}

const clock = (t) => t == null ? "–" : `${Math.floor(t / 3600)}:${String(Math.floor(t / 60) % 60).padStart(2, "0")}`;

function verdicts(told) {
  for (const id of ["verdicts", "charge"]) $(id).classList.remove("stale");
  clearRoutes();
  for (const { trajectory } of told.legs) chart.route(trajectory.x.map((x, k) => [x, trajectory.y[k]]), "--least");
  say(`${told.headline[0].toUpperCase()}${told.headline.slice(1)}.`, told.tasks.some((task) => task.verdict !== "reachable"));
  told.tasks.forEach((task, k) => tasks[k].mark(task.verdict === "reachable" ? "done" : "out"));
  const full = (soc) => soc == null ? "–" : `${(100 * soc).toFixed(0)} %`;
  const rows = [
    ...told.tasks.map((task) => [task.arrival ?? Infinity, [
      task.name,
      task.verdict === "reachable" ? ["reachable", "text good"]
        : [`out of reach: ${task.reason.replaceAll("_", " ")}${task.remedy ? `; ${task.remedy}` : ""}`, "text bad"],
      clock(task.arrival), energy(task.energy), full(task.soc_after),
    ]]),
    ...told.timetable.filter((row) => row.kind === "charge").map((row) => [row.start, [
      row.place, `charges ${Math.round((row.end - row.start) / 60)} min`, clock(row.start), "–", full(row.soc_end),
    ]]),
  ].sort(([a], [b]) => a < b ? -1 : a > b ? 1 : 0);  // by time; what is out of reach comes last
  $("verdicts").replaceChildren(table(["task", "verdict", "at", "energy", "charge after"], rows.map(([, row]) => row)));
  const line = told.timeline;
  const ink = getComputedStyle(document.body).color;
  const axis = { stroke: ink, grid: { stroke: "#8884" }, ticks: { stroke: "#8888" } };
  plot?.destroy();
  plot = new window.uPlot({
    width: $("charge").clientWidth || 340, height: 220, scales: { x: { time: false }, y: { range: [0, 100] } },
    series: [{ label: "time [min]" }, { label: "expected", stroke: "#0072b2", width: 2 },
      { label: "at the asked confidence", stroke: "#d55e00", dash: [6, 4] }],
    axes: [{ ...axis, label: "time [min]", labelSize: 20 }, { ...axis, size: 44, label: "charge [%]", labelSize: 20 }],
  }, [line.t.map((t) => t / 60), line.soc.map((s) => 100 * s), line.soc_lower.map((s) => 100 * s)], $("charge"));
}

// logs

async function drives(files) {
  if (!files.length) return;
  try {
    const names = [];
    for (const file of files) {
      const name = `logs/${Date.now()}-${file.name.replace(/[^\w.+-]/g, "_")}`;
      say(`Sending ${file.name}…`);
      await upload(name, file);
      names.push(name);
    }
    const form = $("drives");
    const whose = { vehicle: form.vehicle.value || null };
    const parts = [];
    if (!whose.vehicle) {
      const number = (key) => form[key].value ? Number(form[key].value) : null;
      whose.robot = { track: number("track"), wheelbase: number("wheelbase"), mass: number("mass"),
        wheel_radius: number("radius"), columns: form.columns.value || null };
      if (!whose.robot.track || !whose.robot.mass) return say("Which robot is this? Give a vehicle, or track and mass of your own.", true);
      const read = await post("start", { log: names[0], robot: whose.robot });
      parts.push(element("h2", "Read as"), table(["channel", "column"],
        Object.entries(read.columns).map(([channel, column]) => [channel, `${column} [${read.units[channel]}]`])),
        ...read.checks.filter((check) => !check.ok).map((check) => element("p", `${check.what}. ${check.remedy}`, "bad")));
      $("found").replaceChildren(...parts);
      if (!read.sound) return say("The log contradicts itself or the robot: see below.", true);
    }
    say("Looking for the robot's parameters…");
    const found = await post("identify", { logs: names, ...whose });
    const rows = (terms) => terms.map((t) => [t.name.replaceAll("_", " "), `${t.symbol} = ${t.value.toPrecision(4)}${t.std_error == null ? "" : ` ± ${t.std_error.toPrecision(2)}`}${unit(t.unit)}`]);
    parts.push(element("h2", "Identified"), table(["term", "value"], rows(found.terms)),
      ...found.warnings.map((text) => element("p", text, "hint")));
    if (names.length > 1) {
      say("Tracing what the model does not explain…");
      const told = await post("diagnose", { logs: names.slice(0, -1), holdout: names.slice(-1), ...whose });
      parts.push(element("h2", "Diagnosis"), element("p", told.verdict.replaceAll("_", " ")),
        table(["effect", "size"], told.effects.map((e) => [e.name.replaceAll("_", " "), `${e.value.toPrecision(4)}${unit(e.unit)}`])),
        element("p", `Error of the energy on the last log: ${percent(told.before.energy_error)} before, ${percent(told.after.energy_error)} after.`),
        ...told.advice.map((text) => element("p", text, "hint")));
    }
    $("found").replaceChildren(...parts);
    say("Done.");
  } catch (error) { say(error.message, true); }
}

// events

for (const tab of document.querySelectorAll("[role=tab]")) {
  tab.addEventListener("click", () => {
    mode = tab.id.slice(4);
    say("");
    clearRoutes();
    if (mode === "route") replan();
    for (const other of document.querySelectorAll("[role=tab]")) {
      other.setAttribute("aria-selected", String(other === tab));
      $(other.id.slice(4)).hidden = other !== tab;
    }
  });
}
scene.map.addEventListener("change", () => load().catch((error) => say(error.message, true)));
scene.surfaces.addEventListener("change", () => load().catch((error) => say(error.message, true)));
scene.model.addEventListener("change", replan);
scene.addEventListener("submit", (event) => event.preventDefault());
$("again").addEventListener("click", reset);
$("far").addEventListener("click", range);
$("battery").addEventListener("submit", evaluate);
$("clear").addEventListener("click", () => { tasks.forEach((task) => task.remove()); tasks = []; stale(); });
const drop = $("drop");
drop.querySelector("input").addEventListener("change", (event) => drives([...event.target.files]));
for (const kind of ["dragover", "dragleave", "drop"]) {
  drop.addEventListener(kind, (event) => {
    event.preventDefault();
    drop.classList.toggle("over", kind === "dragover");
    if (kind === "drop") drives([...event.dataTransfer.files]);
  });
}
begin().catch((error) => say(error.message, true));
