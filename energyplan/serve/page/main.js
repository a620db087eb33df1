// The page: what is asked of the service when something on it changes, and how it is shown.

import { get, post, upload } from "./api.js";
import { Chart } from "./chart.js";

const $ = (id) => document.getElementById(id);
const scene = $("scene");
const status = $("status");
let start = null, goal = null, robots = [], tasks = [], chargers = [], mode = "route", asked = null, plot = null;
const TINTS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];  // of robots, in their order
let files = {}, mission = null, logs = [], playing = 0;  // what the folder holds, the mission that is open, the logs sent, the frame of the animation

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
const energy = (value) => {
  if (value == null) return "–";
  const digits = Math.abs(value) < 36000 ? 3 : Math.abs(value) < 360000 ? 2 : 1;
  return `${(value / 3600).toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits })} Wh`;
};
const percent = (value) => `${(100 * value).toFixed(1)} %`;

// the scene

function options(select, names, none) {
  select.replaceChildren(...(none ? [new Option(none, "")] : []), ...names.map((n) => new Option(n, n)));
}

// The page begins with what the folder holds: its mission if there is one, else its map and model.
async function begin() {
  files = await get("files");
  options(scene.map, files.maps);
  options(scene.surfaces, files.surfaces, "none");
  options($("battery").file, files.missions, "none");
  list("models", [...files.models, ...files.presets.models]);
  list("packs", [...files.batteries, ...files.presets.batteries]);
  const [model] = files.models, [pack] = files.batteries;
  scene.model.value = model ?? "quadriga:full:concrete";
  $("battery").pack.value = pack ?? (model ? "" : "quadriga");
  if (files.missions.length) return open(files.missions[0]);
  if (!files.maps.length) return say("The data folder holds no map (a YAML file with its image).", true);
  await load();
}

function list(id, names) {
  $(id).replaceChildren(...names.map((name) => new Option(name)));
}

async function load() {
  say("Loading the map…");
  const surfaces = scene.surfaces.value;
  const [grid, areas] = await Promise.all([
    get(`maps/${scene.map.value}`), surfaces ? get(`surfaces/${surfaces}`) : null,
  ]);
  reset();
  await draw(grid, areas);
}

async function draw(grid, areas) {
  await chart.show(grid, areas);
  $("legend").replaceChildren(...[["least energy", "var(--least)"], ["shortest", "var(--short)"], ...chart.legend]
    .map(([name, tint]) => { const made = element("span", name, "tint"); made.style.borderColor = tint; return made; }));
}

function reset() {
  for (const marked of [goal, ...robots, ...tasks, ...chargers]) marked?.remove();
  [start, goal, robots, tasks, chargers, mission] = [null, null, [], [], [], null];
  $("battery").file.value = "";
  for (const name of ["charger", "soc"]) $("battery")[name].parentElement.hidden = false;
  $("docks").replaceChildren();
  clearRoutes();
  for (const id of ["verdicts", "charge", "tasks"]) $(id).replaceChildren();
  $("tasks").hidden = true;
  say("Click on the map to place the start, or press Enter on it to place it in the middle.");
}

// What was said of the mission no longer holds where a task or the start was moved.
function stale() {
  if (!$("verdicts").childElementCount) return;
  for (const id of ["verdicts", "charge"]) $(id).classList.add("stale");
  for (const task of tasks) task.mark("");
  chart.routes.clearLayers();
  chart.where([]);
  cancelAnimationFrame(playing);
  say("The mission has changed: ask again whether the battery lasts.");
}

// Mark where the robots begin; a route and a range begin where the first one does.
function begins(each) {
  robots = each.map(({ name = "", start: pose }, k) => {
    const made = chart.pose(each.length > 1 ? `S${k + 1}` : "S", pose, () => { made.moved = true; stale(); replan(); });
    return Object.assign(made, { name });
  });
  [start] = robots;
}

// Place what comes next; with the keyboard it begins in the middle, wherever that is.
function place(x, y, keys = false) {
  if (!keys && chart.blocked(x, y)) return say("There is a wall, or no map: click on free ground.", true);
  if (!start) {
    begins([{ start: [x, y, 0] }]);
    say(mode === "route" ? "Now click where the goal is." : "Now click where tasks are.");
  } else if (mode === "mission") {
    add({ name: `task ${1 + Math.max(0, ...tasks.map((task) => task.number))}`, pose: [x, y, 0], dwell: 600,
      power: 100, window: [0, null], required: false });
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
    const told = await ask("compare", {
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
  chart.where([]);
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
  const of = told.saving_of, parts = of === "energy_steady" ? "breakdown" : "breakdown_driven";
  const kind = of === "energy_steady" ? "energy at steady speeds" : "energy as driven, with its stops";
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
      ...(of === "energy_steady" ? [] : [["energy at steady speeds", energy(best.energy_steady), energy(shortest.energy_steady)]]),
      [best.gap_of === "driven" ? "no route takes less than" : "no route takes less than, at steady speeds", best.lower_bound === null ? "–" : energy(best.lower_bound), "–"],
    ],
  ));
}

// range

async function range() {
  const form = $("battery");
  if (!start) return say("Place the start on the map first.", true);
  if (!form.pack.value && !mission) return say("Name the battery on the tab Mission first.", true);
  const spread = form.spread.value / 100;
  say("Searching for all places in reach…");
  try {
    const told = await ask("range", {
      map: scene.map.value, model: scene.model.value, surfaces: scene.surfaces.value || null,
      start: start.pose, back: $("back").checked ? start.pose : null,
      pack: form.pack.value || mission?.document.battery || null,
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

// Ask the service, and say how far it is where it must compile first.
const ask = (path, body, signal) => post(path, body, ({ event, done, total, left }) => {
  if (event === "compiling") say(`Compiling, once: ${done} of ${total}${left == null ? "" : `, about ${Math.round(left)} s left`}…`);
}, signal);

// missions

// Show a mission's file: its map, places and tasks as the service reads them.
async function open(name) {
  say(`Opening ${name}…`);
  const told = await get(`missions/${name}`);
  reset();
  await draw(told.map, told.areas);
  const folder = name.slice(0, name.lastIndexOf("/") + 1), form = $("battery"), { document } = told;
  const known = (names, own) => names.includes(folder + own) ? folder + own : own;
  scene.map.value = known(files.maps, document.map);
  scene.surfaces.value = known(files.surfaces, document.surfaces ?? "");
  scene.model.value = known(files.models, document.model);
  mission = { name, folder, document, model: scene.model.value };
  form.file.value = name;
  const own = typeof document.battery === "string";
  fill(form.pack, own ? document.battery : "");
  const pack = Object.entries(document.battery ?? {}).map(([key, value]) => `${key.replaceAll("_", " ")} ${value?.mean ?? value}`);
  form.pack.placeholder = own ? "24 V 20 Ah lead-acid" : `as in the file: ${pack.join(", ")}`;
  form.pack.title = form.pack.value || form.pack.placeholder;
  $("docks").textContent = told.chargers.map((one) => {
    const power = typeof one.power === "number" ? `${one.power} W` : "a power curve";
    return `${one.name}: ${power}${one.until == null ? "" : `, until ${Math.round(100 * one.until)} %`}`;
  }).join("; ");
  if (told.chargers.length) $("docks").prepend("Chargers: ");
  for (const [key, value] of [["soc", told.soc], ["reserve", told.reserve], ["spread", told.coefficient_spread]]) fill(form[key], round(100 * value));
  form.charger.parentElement.hidden = told.chargers.length > 0;
  form.soc.parentElement.hidden = told.robots.length > 0;  // each has its own
  fill(form.charger, 0);
  begins(told.robots.length ? told.robots : [told]);
  chargers = told.chargers.map(({ pose }) => {
    const made = chart.pose("C", pose, () => { made.moved = true; stale(); }, "charger");
    return made;
  });
  const listed = Array.isArray(document.tasks);  // or the name of a file of them
  told.tasks.forEach((task, k) => add(task, listed ? document.tasks[k] : said(task)));
  if (mode !== "mission") $("tab-mission").click();
  say(`${name}: ${tasks.length} task${tasks.length > 1 ? "s" : ""}. Move or change them, and ask whether the battery lasts.`);
}

const round = (value) => Number(value.toPrecision(6));

function fill(input, value) {
  input.defaultValue = value ?? "";
  input.value = input.defaultValue;
}

// What a file would say of a task that another file names: what is open is left out.
const said = (task) => Object.fromEntries(Object.entries(task).filter(([, value]) =>
  value != null && !(Array.isArray(value) && (!value.length || value.includes(null)))));

// Add a task, with a row of its own; `raw` is what the file says of it. A path stays where it is.
function add({ name, pose, path = [], dwell, power, window: [first, last], required }, raw = null) {
  const number = 1 + Math.max(0, ...tasks.map((task) => task.number));
  const task = path.length ? chart.row(String(number), path)
    : chart.pose(String(number), pose, () => { task.moved = true; stale(); }, "task");
  const row = element("tr"), input = (label, value, type = "number") => {
    const made = element("input");
    Object.assign(made, { type, min: 0, step: "any", ariaLabel: `${label} of ${name}` });
    if (type === "checkbox") made.checked = made.defaultChecked = value; else fill(made, value);
    made.addEventListener("change", stale);
    const cell = element("td");
    cell.append(made);
    row.append(cell);
    return made;
  };
  row.append(element("td", `${number} ${name}`));
  const minutes = (seconds) => seconds == null ? "" : round(seconds / 60);
  Object.assign(task, {
    name, number, raw, row, dwell: input("minutes", minutes(dwell)), power: input("watts", round(power)),
    first: input("earliest start", first ? minutes(first) : ""), last: input("latest start", minutes(last)),
    required: input("required", required, "checkbox"),
  });
  task.dwell.disabled = path.length > 0;  // it takes as long as its drive
  const drop = element("button", "×"), cell = element("td");
  Object.assign(drop, { type: "button", title: `Remove ${name}` });
  drop.addEventListener("click", () => { task.remove(); row.remove(); tasks = tasks.filter((one) => one !== task); $("tasks").hidden = !tasks.length; stale(); });
  cell.append(drop);
  row.append(cell);
  if (!tasks.length) $("tasks").replaceChildren(...table(["task", "takes [min]", "tool [W]", "not before", "not after", "must", ""], []).children);
  $("tasks").append(row);
  $("tasks").hidden = false;
  tasks.push(task);
}

// What a mission's file would hold: that of the open one, with what was changed on the page.
function written() {
  const form = $("battery"), document = structuredClone(mission?.document ?? { order: "free", return_to: "start" });
  const put = (holder, raw, key, input, value) => {
    if (raw && (input.type === "checkbox" ? input.checked === input.defaultChecked : input.value === input.defaultValue)) return;
    holder[key] = holder[key]?.mean === undefined ? value : { ...holder[key], mean: value };
  };
  if (!mission) Object.assign(document, { map: scene.map.value, ...(scene.surfaces.value && { surfaces: scene.surfaces.value }) });
  const { model } = scene, folder = mission?.folder ?? "";
  if (model.value !== mission?.model) document.model = model.value.startsWith(folder) ? model.value.slice(folder.length) : model.value;
  if (!mission || form.pack.value !== form.pack.defaultValue) document.battery = form.pack.value;
  for (const [key, name] of [["soc", "soc"], ["reserve", "reserve"], ["coefficient_spread", "spread"]]) put(document, mission, key, form[name], form[name].value / 100);
  robots.forEach((one, k) => { if (!mission || one.moved) (document.robots?.[k] ?? document).start = one.pose; });
  const power = Number(form.charger.value);
  if (power) document.chargers = [{ name: "charger", pose: start.pose, power }];
  else chargers.forEach((one, k) => { if (one.moved) document.chargers[k].pose = one.pose; });
  document.tasks = tasks.map((task) => {
    const made = { ...task.raw, name: task.name }, { raw } = task;
    if (!raw || task.moved) made.pose = task.pose;
    put(made, raw, "dwell", task.dwell, 60 * task.dwell.value);
    put(made, raw, "power", task.power, Number(task.power.value));
    put(made, raw, "required", task.required, task.required.checked);
    if ([task.first, task.last].some((one) => one.value !== one.defaultValue)) {
      made.window = [60 * task.first.value, task.last.value === "" ? 1e9 : 60 * task.last.value];  // s
    }
    return made;
  });
  return document;
}

async function evaluate(event) {
  event.preventDefault();
  if (!start || !tasks.length) return say("Place the start and some tasks on the map first.", true);
  if (!$("battery").reportValidity()) return null;
  say("Evaluating the mission…");
  try {
    verdicts(await ask("mission", { mission: mission?.name ?? null, document: written() }));
  } catch (error) { say(error.message, true); }
}

// Keep what the page shows as a mission's file of the folder. JSON is YAML too.
async function save() {
  const name = window.prompt("Name of the mission's file", "mission_new.yaml");
  if (!name) return;
  const file = `${mission?.folder ?? ""}${/\.ya?ml$/.test(name) ? name : `${name}.yaml`}`;
  try {
    await upload(file, new Blob([`${JSON.stringify(written(), null, 1)}\n`]));
    files.missions.push(file);
    options($("battery").file, files.missions, "none");
    await open(file);
    say(`Kept as ${file}, and opened.`);
  } catch (error) { say(error.message, true); }
}

// Show where each robot is at a moment of the timetable; `moment` is its time [s].
function follow(each, moment) {
  chart.where(each.map((one) => {
    const leg = one.legs.findLast(({ departure }) => departure <= moment) ?? one.legs[0];
    if (!leg) return null;
    const { t, x, y } = leg.trajectory, since = t[0] + moment - leg.departure;
    const k = Math.max(0, Math.min(t.length - 1, t.findIndex((time) => time > since) - 1 + (t.at(-1) <= since ? t.length + 1 : 0)));
    const next = Math.min(k + 1, t.length - 1), part = next === k ? 0 : Math.max(0, Math.min(1, (since - t[k]) / (t[next] - t[k])));
    return [x[k] + part * (x[next] - x[k]), y[k] + part * (y[next] - y[k]), one.tint];
  }).filter(Boolean));
}

// A slider over the time of a mission, which can play by itself in about half a minute.
function player(each) {
  const begin = Math.min(...each.flatMap(({ legs }) => legs.slice(0, 1).map(({ departure }) => departure)));
  const end = Math.max(...each.map(({ route }) => route.at(-1).arrival));
  if (!(begin < end)) return element("p");  // nobody drives
  const made = element("p", "", "player"), button = element("button", "Play"), slider = element("input"), time = element("span");
  Object.assign(button, { type: "button" });
  Object.assign(slider, { type: "range", min: begin, max: end, step: "any", value: begin, ariaLabel: "time of the mission" });
  const show = () => { follow(each, Number(slider.value)); time.textContent = `${clock(Number(slider.value))} h`; };
  const stop = () => { cancelAnimationFrame(playing); playing = 0; button.textContent = "Play"; };
  stop();
  slider.addEventListener("input", () => { stop(); show(); });
  button.addEventListener("click", () => {
    if (playing) return stop();
    if (Number(slider.value) >= end - 1e-6) slider.value = begin;
    let last = performance.now(), at = Number(slider.value);
    const step = (now) => {
      at = Math.min(end, at + (now - last) * (end - begin) / 30000);
      last = now;
      slider.value = at;
      show();
      if (at < end && made.isConnected) playing = requestAnimationFrame(step); else stop();
    };
    button.textContent = "Stop";
    playing = requestAnimationFrame(step);
  });
  made.append(button, slider, time);
  show();
  return made;
}

const clock = (t) => {
  if (t == null) return "–";
  const whole = Math.round(t / 60);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
};
const REASONS = {
  no_path: "no drivable path leads there", motor: "a turn on the way is beyond the motors' limits",
  late: "its time window is over by then", time_limit: "no route was found in the time for planning",
  payload: "it leaves more than is on board",
  battery: "the battery does not last", blocked_by_earlier: "alone it could be done, but not with the other tasks",
};

function verdicts(told) {
  for (const id of ["verdicts", "charge"]) $(id).classList.remove("stale");
  clearRoutes();
  const each = told.robots ?? [told], several = each.length > 1;
  each.forEach((one, k) => {
    one.tint = several ? TINTS[k % TINTS.length] : "--least";
    for (const { trajectory } of one.legs) chart.route(trajectory.x.map((x, j) => [x, trajectory.y[j]]), one.tint);
  });
  const less = (told.remedies ?? []).map(({ amount }) =>
    ` Leave the chargers at ${(100 * amount).toFixed(0)} %: ${(told.time_saved / 60).toFixed(0)} min less.`);
  say(`${told.headline[0].toUpperCase()}${told.headline.slice(1)}.${less.join("")}`, told.tasks.some((task) => task.verdict !== "reachable"));
  told.tasks.forEach((task, k) => tasks[k].mark(task.verdict === "reachable" ? "done" : "out"));
  const full = (soc) => soc == null ? "–" : `${(100 * soc).toFixed(0)} %`;
  const named = (one, text) => (several ? `${one.name}: ${text}` : text);
  const row = (one, [what, kind], from, to, joules, soc) => [[from, one.name], [
    [named(one, what), `text ${kind}`], clock(from), to === from ? "" : clock(to), joules, full(soc)]];
  const rows = each.flatMap((one) => [
    ...one.tasks.filter((task) => task.verdict === "reachable")
      .map((task) => row(one, [task.name, "good"], task.arrival, task.departure, energy(task.energy), task.soc_after)),
    ...one.timetable.filter(({ kind }) => kind === "charge")
      .map((stay) => row(one, [`charging at ${stay.place}`, ""], stay.start, stay.end, "–", stay.soc_end)),
    row(one, [one.tasks.length ? `end, at ${one.end}` : "nothing to do", ""], one.route.at(-1).arrival, one.route.at(-1).arrival, "–", one.soc_end),
  ]).sort(([[a]], [[b]]) => a - b).map(([, cells]) => cells);
  const why = (task) => [...new Set(told.left_out?.find(({ name }) => name === task.name)?.reasons ?? [task.reason])]
    .map((reason) => REASONS[reason] ?? reason).join("; ") || "no robot has the skills";
  const left = told.tasks.filter((task) => task.verdict !== "reachable").map((task) => element("p",
    `${task.name}: out of reach; ${why(task)}.${task.detail ? ` ${task.detail[0].toUpperCase()}${task.detail.slice(1)}.` : ""}${task.remedy ? ` Remedy: ${task.remedy}.` : ""}`, "bad"));
  const shares = several ? `${each.map((one) => `${one.name} takes ${energy(one.energy)}`).join(", ")}. ` : "";
  const mains = each.flatMap((one) => one.chargers).reduce((sum, one) => sum + one.energy_mains, 0);
  const most = `${shares}The whole takes ${energy(told.energy)}, with the confidence asked for ${energy(told.energy_upper)} at most.`
    + (mains ? ` The chargers draw ${energy(mains)} from the mains.` : "");
  $("verdicts").replaceChildren(...left, table(["what", "from [h:min]", "to", "energy", "charge after"], rows),
    player(each), element("p", most, "hint"),
    ...told.warnings.map((text) => element("p", text, "hint")));
  const ink = getComputedStyle(document.body).color;
  const axis = { stroke: ink, grid: { stroke: "#8884" }, ticks: { stroke: "#8888" } };
  const lines = each.map(({ timeline: { t, soc, soc_lower: low } }) => [t.map((x) => x / 60), ...[soc, low].map((line) => line.map((x) => 100 * x))]);
  const drawn = several ? window.uPlot.join(lines) : lines[0];
  const reserves = [...new Set(each.map(({ timeline }) => timeline.reserve[0]))];
  plot?.destroy();
  plot = new window.uPlot({
    width: $("charge").clientWidth || 340, height: 220, scales: { x: { time: false }, y: { range: [0, 100] } },
    series: [{ label: "time [min]" }, ...each.flatMap((one, k) => [
      { label: named(one, "expected"), stroke: TINTS[k % TINTS.length], width: 2, spanGaps: true },
      { label: named(one, "at the asked confidence"), stroke: TINTS[(several ? k : 1) % TINTS.length], dash: [6, 4], spanGaps: true },
    ]), ...reserves.map(() => ({ label: "reserve", stroke: ink, dash: [2, 3] }))],
    axes: [{ ...axis, label: "time [min]", labelSize: 20 }, { ...axis, size: 44, label: "charge [%]", labelSize: 20 }],
  }, [...drawn, ...reserves.map((reserve) => drawn[0].map(() => 100 * reserve))], $("charge"));
}

// logs

async function drives(chosen) {
  if (!chosen.length) return;
  try {
    logs = [];
    for (const file of chosen) {
      const name = `logs/${Date.now()}-${file.name.replace(/[^\w.+-]/g, "_")}`;
      say(`Sending ${file.name}…`);
      await upload(name, file);
      logs.push(name);
    }
    await learn();
  } catch (error) { say(error.message, true); }
}

// Learn from the logs that were sent; again, once more is known of the robot.
async function learn() {
  const form = $("drives"), names = logs;
  const whose = { vehicle: form.vehicle.value || null };
  const parts = [];
  if (!whose.vehicle) {
    const number = (key) => form[key].value ? Number(form[key].value) : null;
    whose.robot = { track: number("track"), wheelbase: number("wheelbase"), mass: number("mass"),
      wheel_radius: number("radius"), columns: form.columns.value || null };
    if (!whose.robot.track || !whose.robot.mass) return say("Which robot is this? Give a vehicle, or track and mass of your own.", true);
    const read = await ask("start", { log: names[0], robot: whose.robot });
    parts.push(element("h2", "Read as"), table(["channel", "column"],
      Object.entries(read.columns).map(([channel, column]) => [channel, `${column} [${read.units[channel]}]`])),
      ...read.checks.filter((check) => !check.ok).map((check) => element("p", `${check.what}. ${check.remedy}`, "bad")));
    $("found").replaceChildren(...parts);
    if (!read.sound) return say("The log contradicts itself or the robot: see below.", true);
  }
  say("Looking for the robot's parameters…");
  const found = await ask("identify", { logs: names, ...whose });
  const rows = (terms) => terms.map((t) => [t.name.replaceAll("_", " "), `${t.symbol} = ${t.value.toPrecision(4)}${t.std_error == null ? "" : ` ± ${t.std_error.toPrecision(2)}`}${unit(t.unit)}`]);
  parts.push(element("h2", "Identified"), table(["term", "value"], rows(found.terms)),
    ...found.warnings.map((text) => element("p", text, "hint")), keeper(found.model_file));
  if (names.length > 1) {
    say("Tracing what the model does not explain…");
    const told = await ask("diagnose", { logs: names.slice(0, -1), holdout: names.slice(-1), ...whose });
    parts.push(element("h2", "Diagnosis"), element("p", told.verdict.replaceAll("_", " ")),
      table(["effect", "size"], told.effects.map((e) => [e.name.replaceAll("_", " "), `${e.value.toPrecision(4)}${unit(e.unit)}`])),
      element("p", `Error of the energy on the last log: ${percent(told.before.energy_error)} before, ${percent(told.after.energy_error)} after.`),
      ...told.advice.map((text) => element("p", text, "hint")), keeper(told.model_file));
  }
  $("found").replaceChildren(...parts);
  say("Done.");
}

// A button that keeps a model in the folder, has the page use it, and lets it be downloaded.
function keeper(text) {
  const made = element("p"), button = element("button", "Keep this model and use it");
  button.addEventListener("click", async () => {
    const name = `${mission?.folder ?? ""}models/model-${Date.now()}.yaml`;  // where the mission may name it
    try {
      await upload(name, new Blob([text]));
      files.models.push(name);
      list("models", [...files.models, ...files.presets.models]);
      scene.model.value = name;
      stale();
      const link = Object.assign(element("a", "Download it"), { href: URL.createObjectURL(new Blob([text])), download: name.split("/").pop() });
      made.replaceChildren(`Kept as ${name}; Route and Mission use it. `, link);
    } catch (error) { say(error.message, true); }
  });
  made.append(button);
  return made;
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
scene.model.addEventListener("change", () => { stale(); replan(); });
scene.addEventListener("submit", (event) => event.preventDefault());
$("again").addEventListener("click", reset);
$("far").addEventListener("click", range);
$("battery").addEventListener("submit", evaluate);
$("save").addEventListener("click", save);
$("battery").pack.addEventListener("input", ({ target }) => { target.title = target.value || target.placeholder; });
$("battery").file.addEventListener("change", ({ target }) => (target.value ? open(target.value) : load()).catch((error) => say(error.message, true)));
for (const input of $("battery").querySelectorAll("input")) input.addEventListener("change", stale);
$("clear").addEventListener("click", () => { tasks.forEach((task) => task.remove()); tasks = []; $("tasks").replaceChildren(); $("tasks").hidden = true; stale(); });
$("drives").addEventListener("submit", (event) => event.preventDefault());
$("drives").addEventListener("change", ({ target }) => { if (logs.length && target.type !== "file") learn().catch((error) => say(error.message, true)); });
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
