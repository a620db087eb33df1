// The page: what is asked of the service when something on it changes, and how it is shown.

import { get, post, upload } from "./api.js";
import { Chart } from "./chart.js";
import { counted, known, language, number, preferred, relabel, speak, t } from "./texts.js";

const $ = (id) => document.getElementById(id);
const scene = $("scene");
const status = $("status");
let start = null, goal = null, robots = [], tasks = [], chargers = [], mode = "route", asked = null, plot = null;
let said = () => "", shown = () => {};  // the status, and what shows the last answer, said again in another language
const TINTS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];  // of robots, in their order
let files = {}, mission = null, logs = [], playing = 0;  // what the folder holds, the mission that is open, the logs sent, the frame of the animation

const chart = new Chart("map", place);

// Set the status to a text, or to one of the table by its key.
function say(text, bad = false) {
  said = typeof text === "function" ? text : () => text;
  status.textContent = said();
  status.classList.toggle("bad", bad);
}

const tell = (key, values = {}, bad = false) => say(() => t(key, values), bad);

// -- small pieces of HTML: text is always set as text ------------------------------------------

function element(tag, text = "", name = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  made.className = name;
  return made;
}

// Give an element a text of the table that stays right in another language; `part` as in `relabel`.
function labelled(made, part, key, values = {}) {
  Object.assign(made.dataset, { [part]: key, ...values });
  relabel([made]);
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
  return `${number(value / 3600, digits)} Wh`;
};
const percent = (value) => `${number(100 * value, 1)} %`;
const figure = (value, digits) => Number(value.toPrecision(digits)).toLocaleString(language, { maximumSignificantDigits: digits });
const degrees = (value) => `${number(value * 180 / Math.PI)}°`;

// the scene

function options(select, names, none) {
  select.replaceChildren(...(none ? [labelled(new Option("", ""), "text", none)] : []), ...names.map((n) => new Option(n, n)));
}

// Say everything in a language.
async function switched(name) {
  await speak(name);
  $("language").value = name;
  $("glossary").querySelector("dl").replaceChildren(...t("terms").flatMap(([term, meaning]) => [element("dt", term), element("dd", meaning)]));
  status.textContent = said();
  shown();
}

// The page begins with what the folder holds: its mission if there is one, else its map and model.
async function begin() {
  await switched(preferred());
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
  if (!files.maps.length) return tell("no_map", {}, true);
  await load();
}

function list(id, names) {
  $(id).replaceChildren(...names.map((name) => new Option(name)));
}

async function load() {
  tell("loading");
  const surfaces = scene.surfaces.value;
  const [grid, areas] = await Promise.all([
    get(`maps/${scene.map.value}`), surfaces ? get(`surfaces/${surfaces}`) : null,
  ]);
  reset();
  await draw(grid, areas);
}

async function draw(grid, areas) {
  await chart.show(grid, areas);
  const ways = ["least_energy", "shortest"].map((key) => labelled(element("span", "", "tint"), "text", key));
  const grounds = chart.legend.map(([name]) => element("span", name, "tint"));
  const tints = ["var(--least)", "var(--short)", ...chart.legend.map(([, tint]) => tint)];
  $("legend").replaceChildren(...[...ways, ...grounds].flatMap((made, k) => { made.style.borderColor = tints[k]; return [made, " "]; }));
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
  tell("place_start");
}

// What was said of the mission no longer holds where a task or the start was moved.
function stale() {
  if (!$("verdicts").childElementCount) return;
  for (const id of ["verdicts", "charge"]) $(id).classList.add("stale");
  for (const task of tasks) task.mark("");
  chart.routes.clearLayers();
  chart.where([]);
  cancelAnimationFrame(playing);
  tell("stale");
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
  if (!keys && chart.blocked(x, y)) return tell("blocked", {}, true);
  if (!start) {
    begins([{ start: [x, y, 0] }]);
    tell(mode === "route" ? "place_goal" : "place_tasks");
  } else if (mode === "mission") {
    add({ name: t("task", { number: 1 + Math.max(0, ...tasks.map((task) => task.number)) }), pose: [x, y, null], dwell: 600,
      power: 100, window: [0, null], required: false });
    stale();
    say(() => counted("tasks_placed", tasks.length));
  } else if (!goal) {
    goal = chart.pose("G", [x, y, null], replan, "", true);
    replan();
  }
}

// A place without a heading is a place at any.
const target = ([x, y, yaw]) => yaw == null ? [x, y] : [x, y, yaw];

// routes

async function replan() {
  if (!start || !goal || mode !== "route") return;
  asked?.abort();
  const mine = asked = new AbortController();
  tell("planning");
  try {
    const told = await ask("compare", {
      map: scene.map.value, model: scene.model.value, surfaces: scene.surfaces.value || null,
      start: start.pose, goal: target(goal.pose), effort: 15000,
    }, mine.signal);
    if (mine !== asked) return;
    show(told);
  } catch (error) {
    if (error.name !== "AbortError") { clearRoutes(); say(error.message, true); }
  }
}

function clearRoutes() {
  shown = () => {};
  chart.routes.clearLayers();
  chart.reach.clearLayers();
  chart.where([]);
  $("answer").replaceChildren();
}

function show(told) {
  clearRoutes();
  shown = () => show(told);
  if (told.path === null) return tell("no_path", { reason: told.reason }, true);
  const { energy_optimal: best, shortest } = told;
  chart.route(shortest.path, "--short", true);
  chart.route(best.path, "--least");
  goal.turned(best.goal_reached[2]);
  tell("plan_again");
  const lead = element("p");
  // Saving, joules and terms are of one energy: that of driving with all stops, where there is one.
  const of = told.saving_of, parts = of === "energy_steady" ? "breakdown" : "breakdown_driven";
  lead.append(element("span", energy(best[of]), "big least"), ` ${t(best.potential < 0 ? "saves_downhill" : "saves", { share: percent(told.saving) })}`);
  const terms = [...new Set([...Object.keys(best[parts]), ...Object.keys(shortest[parts])])];
  const both = (name, of_one) => [name, of_one(best), of_one(shortest)];
  $("answer").replaceChildren(lead, table(
    ["", [t("least_energy"), "least"], [t("shortest"), "short"]],
    [
      ...terms.map((name) => both(name.replaceAll("_", " "), (one) => energy(one[parts][name] ?? 0))),
      both(t(of === "energy_steady" ? "energy_steady" : "energy_driven"), (one) => energy(one[of])),
      both(t("length"), (one) => `${number(one.length, 1)} m`),
      both(t("turning"), (one) => degrees(one.turning)),
      ...(goal.pose[2] == null ? [both(t("arrives"), (one) => degrees(one.goal_reached[2]))] : []),
      ...(of === "energy_steady" ? [] : [both(t("energy_steady"), (one) => energy(one.energy_steady))]),
      [t(best.gap_of === "driven" ? "bound_driven" : "bound_steady"), best.lower_bound === null ? "–" : energy(best.lower_bound), "–"],
    ],
  ));
}

// range

async function range() {
  const form = $("battery");
  if (!start) return tell("place_start_first", {}, true);
  if (!form.pack.value && !mission) return tell("name_battery", {}, true);
  const spread = form.spread.value / 100;
  tell("searching");
  try {
    const told = await ask("range", {
      map: scene.map.value, model: scene.model.value, surfaces: scene.surfaces.value || null,
      start: start.pose, back: $("back").checked ? start.pose : null,
      pack: form.pack.value || mission?.document.battery || null,
      soc: form.soc.value / 100, reserve: form.reserve.value / 100,
      coefficient_spread: spread, confidence: spread > 0 ? 0.95 : null,
    });
    inReach(told, `in_reach${$("back").checked ? "_back" : ""}${spread > 0 ? "_sure" : ""}`);
  } catch (error) { say(error.message, true); }
}

function inReach(told, key) {
  clearRoutes();
  shown = () => inReach(told, key);
  chart.areas(told.areas, energy);
  tell(key, { area: number(told.contours.at(-1).area) });
  $("answer").replaceChildren(table([t("with_energy"), t("area_in_reach")],
    told.contours.map((line) => [energy(line.energy), `${number(line.area)} m²`])));
}

// Ask the service, and say how far it is where it must compile first.
const ask = (path, body, signal) => post(path, body, ({ event, done, total, left }) => {
  if (event === "compiling") tell(left == null ? "compiling" : "compiling_left", { done, total, left: Math.round(left ?? 0) });
}, signal);

// missions

// Show a mission's file: its map, places and tasks as the service reads them.
async function open(name) {
  tell("opening", { name });
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
  const pack = own ? [] : Object.entries(document.battery ?? {}).map(([key, value]) => `${key.replaceAll("_", " ")} ${value?.mean ?? value}`);
  labelled(form.pack, "placeholder", own ? "pack_example" : "as_in_file", { battery: pack.join(", ") });
  form.pack.title = form.pack.value || form.pack.placeholder;
  $("docks").replaceChildren(...told.chargers.length ? [labelled(element("span"), "text", "chargers", { list: told.chargers.map(dock).join("; ") })] : []);
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
  told.tasks.forEach((task, k) => add(task, listed ? document.tasks[k] : given(task)));
  if (mode !== "mission") $("tab-mission").click();
  say(() => counted("opened", tasks.length, { name }));
}

function dock({ name, power, until }) {
  const values = { name, power: typeof power === "number" ? `${power} W` : t("power_curve"), soc: until == null ? "" : `${Math.round(100 * until)} %` };
  return t(until == null ? "charger_item" : "charger_item_until", values);
}

const round = (value) => Number(value.toPrecision(6));

function fill(input, value) {
  input.defaultValue = value ?? "";
  input.value = input.defaultValue;
}

// What a file would say of a task that another file names: what is open is left out.
const given = (task) => Object.fromEntries(Object.entries(task).filter(([, value]) =>
  value != null && !(Array.isArray(value) && (!value.length || value.includes(null)))));

const COLUMNS = ["task", "minutes", "watts", "first", "last", "required"];

// Add a task, with a row of its own; `raw` is what the file says of it. A path stays where it is.
function add({ name, pose, path = [], goals = [], dwell, power, window: [first, last], required }, raw = null) {
  const number = 1 + Math.max(0, ...tasks.map((task) => task.number));
  const task = path.length ? chart.row(String(number), path)
    : chart.pose(String(number), goals.length === 1 && goals[0].yaw == null ? [pose[0], pose[1], null] : pose,
      () => { task.moved = true; stale(); }, "task", true);
  const row = element("tr"), input = (label, value, type = "number") => {
    const made = labelled(element("input"), "label", label, { name });
    Object.assign(made, { type, min: 0, step: "any" });
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
    name, number, raw, row, dwell: input("minutes_of", path.length ? "" : minutes(dwell)), power: input("watts_of", round(power)),
    first: input("earliest_of", first ? minutes(first) : ""), last: input("latest_of", minutes(last)),
    required: input("required_of", required, "checkbox"),
  });
  task.dwell.disabled = path.length > 0;  // it takes as long as its drive
  const drop = element("button", "×"), cell = element("td");
  labelled(Object.assign(drop, { type: "button" }), "hint", "remove", { name });
  drop.addEventListener("click", () => { task.remove(); row.remove(); tasks = tasks.filter((one) => one !== task); $("tasks").hidden = !tasks.length; stale(); });
  cell.append(drop);
  row.append(cell);
  if (!tasks.length) {
    const head = element("tr");
    head.append(...COLUMNS.map((key) => labelled(element("th"), "text", `col_${key}`)), element("th"));
    $("tasks").replaceChildren(head);
  }
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
    if (!raw || task.moved) {
      made.pose = target(task.pose);
      if (made.pose.length === 2) delete made.heading;
    }
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
  if (!start || !tasks.length) return tell("place_both", {}, true);
  if (!$("battery").reportValidity()) return null;
  tell("evaluating");
  try {
    const needed = tasks.map((task) => task.required.checked);
    verdicts(await ask("mission", { mission: mission?.name ?? null, document: written() }), needed);
  } catch (error) { say(error.message, true); }
}

// Keep what the page shows as a mission's file of the folder. JSON is YAML too.
async function save() {
  const name = window.prompt(t("name_file"), "mission_new.yaml");
  if (!name) return;
  const file = `${mission?.folder ?? ""}${/\.ya?ml$/.test(name) ? name : `${name}.yaml`}`;
  try {
    await upload(file, new Blob([`${JSON.stringify(written(), null, 1)}\n`]));
    files.missions.push(file);
    options($("battery").file, files.missions, "none");
    await open(file);
    tell("kept", { file });
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
  const made = element("p", "", "player"), button = element("button", t("play")), slider = element("input"), time = element("span");
  Object.assign(button, { type: "button" });
  Object.assign(slider, { type: "range", min: begin, max: end, step: "any", value: begin, ariaLabel: t("time_of_mission") });
  const show = () => { follow(each, Number(slider.value)); time.textContent = t("hours", { time: clock(Number(slider.value)) }); };
  const stop = () => { cancelAnimationFrame(playing); playing = 0; button.textContent = t("play"); };
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
    button.textContent = t("stop");
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

// What comes of a mission, in sentences; `needed` says which of its tasks are required.
function headline(told, needed) {
  const out = told.tasks.map((task) => task.verdict !== "reachable"), all = out.length;
  const [lost, hard] = [out.filter(Boolean).length, out.filter((gone, k) => gone && needed[k]).length];
  if (!all) return t("nothing_to_do");
  if (hard) return [t("not_feasible"), all === 1 ? t("cannot_only") : counted("cannot", lost, { all }), ...(hard < lost ? [t("cannot_required", { count: hard })] : [])].join(" ");
  const first = !told.feasible ? [t("not_feasible"), t("no_end")] : !lost ? [counted("all_done", all)] : needed.some(Boolean) ? [t("required_done")] : [];
  return [...first, ...(lost ? [counted("optional_out", lost, { all })] : [])].join(" ");
}

function remedyText({ kind, amount, unit, task, where }) {
  const value = amount ?? 0;
  const which = kind === "speed" && amount == null ? ".cheapest" : kind === "capacity" && unit === "1" ? ".strings" : where === "chargers" ? ".chargers" : "";
  return t(`remedy.${kind}${which}`, { amount: figure(value, 4), percent: `${figure(100 * value, 3)} %`, energy: `${number(value / 3600)} Wh`, minutes: figure(value / 60, 2), task });
}

// Why a task is left out, and what would change that; the service's own words are its title.
function leftOut(task, reasons) {
  const why = reasons.map((reason) => t(`reason.${reason}`)).join("; ") || t("no_robot");
  const parts = [t("out_of_reach", { name: task.name, why })];
  if (task.shortfall > 0) parts.push(t("shortfall", { missing: energy(task.shortfall) }));
  else if (task.detail && reasons.length && task.reason !== "blocked_by_earlier") parts.push(t("in_words", { text: task.detail }));
  const remedies = [...task.remedies.map(remedyText), ...(known(`advice.${task.reason}`) ? [t(`advice.${task.reason}`)] : [])];
  if (remedies.length) parts.push(t("remedy", { list: remedies.join(t("or")) }));
  return Object.assign(element("p", parts.join(" "), "bad"), { title: [task.detail, task.remedy].filter(Boolean).join("; ") });
}

const full = (soc) => soc == null ? "–" : `${number(100 * soc)} %`;

// What each robot does from when to when, with rows of totals of their own.
function timetable(told, each) {
  const several = each.length > 1, named = (one, text) => several ? t("of_robot", { name: one.name, text }) : text;
  const row = (one, what, kind, from, to, joules, soc) => [from, [
    [named(one, what), `text ${kind}`], clock(from), to === from ? "" : clock(to), joules, full(soc)]];
  const end = (one) => one.route.at(-1).arrival;
  const rows = each.flatMap((one) => [
    ...one.tasks.filter((task) => task.verdict === "reachable")
      .map((task) => row(one, task.name, "good", task.arrival, task.departure, energy(task.energy), task.soc_after)),
    ...one.timetable.filter(({ kind }) => kind === "charge")
      .map((stay) => row(one, t("charging_at", { place: stay.place }), "", stay.start, stay.end, "–", stay.soc_end)),
    row(one, one.tasks.length ? t("end_at", { place: one.end === "start" ? t("start") : one.end }) : t("idle"), "", end(one), end(one), "–", one.soc_end),
  ]).sort(([a], [b]) => a - b).map(([, cells]) => cells);
  const began = Math.min(...each.map((one) => one.route[0].departure)), ended = Math.max(...each.map(end));
  const mains = each.flatMap((one) => one.chargers).reduce((sum, one) => sum + one.energy_mains, 0);
  const totals = [
    ...(several ? each.map((one) => [[named(one, t("total")), "text"], clock(one.route[0].departure), clock(end(one)), energy(one.energy), full(one.soc_end)]) : []),
    [[t("total"), "text"], clock(began), clock(ended), energy(told.energy), several ? "" : full(told.soc_end)],
    [[t("total_upper"), "text"], "", "", energy(told.energy_upper), several ? "" : full(told.soc_end_lower)],
    ...(mains ? [[[t("from_mains"), "text"], "", "", energy(mains), ""]] : []),
  ];
  const made = table(["what", "from", "to", "energy", "charge"].map((key) => t(`col_${key}`)), [...rows, ...totals]);
  for (const line of [...made.rows].slice(-totals.length)) {
    line.classList.add("total");
    if (line.cells[1].textContent) continue;
    line.cells[0].colSpan = 3;  // it has no times
    for (const empty of [line.cells[2], line.cells[1]]) empty.remove();
  }
  return made;
}

function verdicts(told, needed) {
  for (const id of ["verdicts", "charge"]) $(id).classList.remove("stale");
  clearRoutes();
  shown = () => verdicts(told, needed);
  const each = told.robots ?? [told], several = each.length > 1;
  each.forEach((one, k) => {
    one.tint = several ? TINTS[k % TINTS.length] : "--least";
    for (const { trajectory } of one.legs) chart.route(trajectory.x.map((x, j) => [x, trajectory.y[j]]), one.tint);
  });
  const less = () => (told.remedies ?? []).map((one) => t("shorter", { remedy: remedyText(one), minutes: number(told.time_saved / 60) }));
  say(() => [headline(told, needed), ...less()].join(" "), !told.feasible);
  told.tasks.forEach((task, k) => {
    tasks[k].mark(task.verdict === "reachable" ? "done" : "out");
    if (task.verdict === "reachable") tasks[k].turned?.(task.pose[2]);
  });
  const named = (one, text) => several ? t("of_robot", { name: one.name, text }) : text;
  const left = told.tasks.filter((task) => task.verdict !== "reachable")
    .map((task) => leftOut(task, [...new Set(told.left_out?.find(({ name }) => name === task.name)?.reasons ?? [task.reason])]));
  $("verdicts").replaceChildren(...left, timetable(told, each), player(each),
    ...told.warnings.map((text) => element("p", text, "hint")));
  const ink = getComputedStyle(document.body).color;
  const axis = { stroke: ink, grid: { stroke: "#8884" }, ticks: { stroke: "#8888" } };
  const lines = each.map(({ timeline: { t, soc, soc_lower: low } }) => [t.map((x) => x / 60), ...[soc, low].map((line) => line.map((x) => 100 * x))]);
  const drawn = several ? window.uPlot.join(lines) : lines[0];
  const reserves = [...new Set(each.map(({ timeline }) => timeline.reserve[0]))];
  plot?.destroy();
  plot = new window.uPlot({
    width: $("charge").clientWidth || 340, height: 220, scales: { x: { time: false }, y: { range: [0, 100] } },
    series: [{ label: t("time_axis") }, ...each.flatMap((one, k) => [
      { label: named(one, t("expected")), stroke: TINTS[k % TINTS.length], width: 2, spanGaps: true },
      { label: named(one, t("at_confidence")), stroke: TINTS[(several ? k : 1) % TINTS.length], dash: [6, 4], spanGaps: true },
    ]), ...reserves.map(() => ({ label: t("reserve_line"), stroke: ink, dash: [2, 3] }))],
    axes: [{ ...axis, label: t("time_axis"), labelSize: 20 }, { ...axis, size: 44, label: t("charge_axis"), labelSize: 20 }],
  }, [...drawn, ...reserves.map((reserve) => drawn[0].map(() => 100 * reserve))], $("charge"));
}

// logs

async function drives(chosen) {
  if (!chosen.length) return;
  try {
    logs = [];
    for (const file of chosen) {
      const name = `logs/${Date.now()}-${file.name.replace(/[^\w.+-]/g, "_")}`;
      tell("sending", { name: file.name });
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
    if (!whose.robot.track || !whose.robot.mass) return tell("which_robot", {}, true);
    const read = await ask("start", { log: names[0], robot: whose.robot });
    parts.push(element("h2", t("read_as")), table([t("col_channel"), t("col_column")],
      Object.entries(read.columns).map(([channel, column]) => [channel, `${column} [${read.units[channel]}]`])),
      ...read.checks.filter((check) => !check.ok).map((check) => element("p", `${check.what}. ${check.remedy}`, "bad")));
    $("found").replaceChildren(...parts);
    if (!read.sound) return tell("contradicts", {}, true);
  }
  tell("identifying");
  const found = await ask("identify", { logs: names, ...whose });
  const rows = (terms) => terms.map((t) => [t.name.replaceAll("_", " "), `${t.symbol} = ${t.value.toPrecision(4)}${t.std_error == null ? "" : ` ± ${t.std_error.toPrecision(2)}`}${unit(t.unit)}`]);
  parts.push(element("h2", t("identified")), table([t("col_term"), t("col_value")], rows(found.terms)),
    ...found.warnings.map((text) => element("p", text, "hint")), keeper(found.model_file));
  if (names.length > 1) {
    tell("diagnosing");
    const told = await ask("diagnose", { logs: names.slice(0, -1), holdout: names.slice(-1), ...whose });
    parts.push(element("h2", t("diagnosis")), element("p", t(`verdict.${told.verdict}`)),
      table([t("col_effect"), t("col_size")], told.effects.map((e) => [e.name.replaceAll("_", " "), `${e.value.toPrecision(4)}${unit(e.unit)}`])),
      element("p", t("error_before_after", { before: percent(told.before.energy_error), after: percent(told.after.energy_error) })),
      ...told.advice.map((text) => element("p", text, "hint")), keeper(told.model_file));
  }
  $("found").replaceChildren(...parts);
  tell("done");
}

// A button that keeps a model in the folder, has the page use it, and lets it be downloaded.
function keeper(text) {
  const made = element("p"), button = element("button", t("keep_model"));
  button.addEventListener("click", async () => {
    const name = `${mission?.folder ?? ""}models/model-${Date.now()}.yaml`;  // where the mission may name it
    try {
      await upload(name, new Blob([text]));
      files.models.push(name);
      list("models", [...files.models, ...files.presets.models]);
      scene.model.value = name;
      stale();
      const link = Object.assign(element("a", t("download")), { href: URL.createObjectURL(new Blob([text])), download: name.split("/").pop() });
      made.replaceChildren(`${t("kept_model", { name })} `, link);
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
$("language").addEventListener("change", ({ target: { value } }) => { localStorage.setItem("language", value); switched(value); });
$("explain").addEventListener("click", () => { $("glossary").open = true; });
$("again").addEventListener("click", reset);
$("far").addEventListener("click", range);
$("battery").addEventListener("submit", evaluate);
$("save").addEventListener("click", save);
$("battery").pack.addEventListener("input", ({ target: pack }) => { pack.title = pack.value || pack.placeholder; });
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
