// The map: a picture of the occupied cells, poses that can be dragged, routes.
// Leaflet's plane has y upwards; "at" turns metres of the world into its latitude and longitude.

import { relabel, t } from "./texts.js";

const L = window.L;
const at = (x, y) => L.latLng(y, x);
const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export class Chart {
  constructor(element, onClick) {
    this.map = L.map(element, {
      crs: L.CRS.Simple, minZoom: -6, maxZoom: 9, zoomSnap: 0.25, attributionControl: false,
      boxZoom: false, keyboard: true,
    });
    this.ground = L.layerGroup().addTo(this.map);
    this.reach = L.layerGroup().addTo(this.map);
    this.routes = L.layerGroup().addTo(this.map);
    this.robots = L.layerGroup().addTo(this.map);
    L.control.scale({ imperial: false }).addTo(this.map);
    this.map.on("click", (event) => onClick(event.latlng.lng, event.latlng.lat));
    this.map.getContainer().addEventListener("keydown", (event) => {
      if (event.key !== "Enter" || event.target !== this.map.getContainer()) return;
      const { lat, lng } = this.map.getCenter();
      onClick(lng, lat, true);
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.repaint());
  }

  // Draw a map: its frame may be turned, so cells are drawn into a canvas of the world's axes.
  async show(grid, surfaces) {
    const cells = new Image();
    cells.src = grid.image;
    await cells.decode();
    this.shown = [{ ...grid, cells }, surfaces];
    this.repaint();
    this.map.fitBounds(this.bounds);
  }

  repaint() {
    if (!this.shown) return;
    const [grid, surfaces] = this.shown;
    const [x0, y0, yaw] = grid.origin;
    const [c, s, r] = [Math.cos(yaw), Math.sin(yaw), grid.resolution];
    const world = (col, row) => [x0 + r * (c * col - s * row), y0 + r * (s * col + c * row)];
    const corners = [[0, 0], [grid.columns, 0], [0, grid.rows], [grid.columns, grid.rows]]
      .map(([col, row]) => world(col, row));
    const low = [0, 1].map((k) => Math.min(...corners.map((p) => p[k])));
    const high = [0, 1].map((k) => Math.max(...corners.map((p) => p[k])));
    const scale = Math.min(1 / r, 4096 / Math.max(high[0] - low[0], high[1] - low[1]));
    const canvas = document.createElement("canvas");
    canvas.width = Math.ceil(scale * (high[0] - low[0]));
    canvas.height = Math.ceil(scale * (high[1] - low[1]));
    const pen = canvas.getContext("2d");
    // pixel = scale * (x - low, high - y), of x, y = world(col, row)
    pen.setTransform(scale * r * c, -scale * r * s, -scale * r * s, -scale * r * c,
      scale * (x0 - low[0]), scale * (high[1] - y0));
    pen.imageSmoothingEnabled = false;
    pen.drawImage(grid.cells, 0, 0);
    pen.resetTransform();
    pen.globalCompositeOperation = "source-in";
    pen.fillStyle = color("--wall");
    pen.fillRect(0, 0, canvas.width, canvas.height);
    // whether a wall is at a place, or the map ends before it
    this.blocked = (x, y) => {
      const [column, row] = [Math.floor(scale * (x - low[0])), Math.floor(scale * (high[1] - y))];
      return !(column >= 0 && row >= 0 && column < canvas.width && row < canvas.height)
        || pen.getImageData(column, row, 1, 1).data[3] > 127;
    };
    this.bounds = L.latLngBounds(at(...low), at(...high));
    this.ground.clearLayers();
    this.legend = [];
    if (surfaces) {
      const tints = ["#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#f0e442"];
      const names = [];
      L.geoJSON(surfaces, {
        coordsToLatLng: ([x, y]) => at(x, y), interactive: false,
        style: (feature) => {
          const name = feature.properties.surface ?? feature.properties.model;
          if (!names.includes(name)) names.push(name);
          const tint = /keep.?out/.test(name) ? "#d55e00" : tints[names.indexOf(name) % tints.length];
          if (!this.legend.some(([known]) => known === name)) this.legend.push([name, tint]);
          return { color: tint, weight: 1, fillOpacity: 0.22 };
        },
      }).addTo(this.ground);
    }
    L.imageOverlay(canvas.toDataURL(), this.bounds, { className: "walls" }).addTo(this.ground);
  }

  // A pose with a ring for its heading; calls back after it was moved. One that may be `free` has no heading while
  // its third number is null; then the ring shows at which one it was reached.
  pose(label, [x, y, yaw], onChange, kind = "", free = false) {
    const reach = 1.0;
    let reached = 0;
    const pose = [x, y, yaw];
    const icon = (name) => L.divIcon({
      className: "", html: `<div class="pin ${name}">${label}</div>`, iconSize: [26, 26],
      iconAnchor: [kind === "charger" ? 36 : 13, 13],  // a dock is often where the robot begins
    });
    const marker = L.marker(at(x, y), {
      draggable: true, icon: icon(kind), title: label, alt: t("pose_of", { name: label }), keyboard: true,
    }).addTo(this.map);
    const line = L.polyline([], { color: "#333", weight: 3 }).addTo(this.map);
    const arrow = L.marker(at(x, y), {
      draggable: true, keyboard: false,
      icon: L.divIcon({ className: "", html: '<div class="arrow"></div>', iconSize: [16, 16] }),
    }).addTo(this.map);
    Object.assign(arrow.getElement().dataset, { hint: "heading_of", name: label });
    relabel([arrow.getElement()]);
    const draw = () => {
      const heading = pose[2] ?? reached;
      const tip = at(pose[0] + reach * Math.cos(heading), pose[1] + reach * Math.sin(heading));
      arrow.getElement().firstChild.classList.toggle("free", pose[2] == null);
      line.setStyle({ dashArray: pose[2] == null ? "2 6" : null });
      marker.setLatLng(at(pose[0], pose[1]));
      arrow.setLatLng(tip);
      line.setLatLngs([at(pose[0], pose[1]), tip]);
    };
    marker.on("drag", () => { [pose[0], pose[1]] = place(marker); draw(); });
    const release = () => { if (free && pose[2] != null) { reached = pose[2]; pose[2] = null; draw(); onChange(); } };
    arrow.on("click", release);
    arrow.on("drag", () => {
      const [ax, ay] = place(arrow);
      pose[2] = Math.atan2(ay - pose[1], ax - pose[0]);
      arrow.getElement().firstChild.classList.remove("free");
      line.setLatLngs([at(pose[0], pose[1]), at(ax, ay)]);
    });
    for (const part of [marker, arrow]) part.on("dragend", () => { draw(); onChange(); });
    marker.getElement().addEventListener("keydown", (event) => {
      if (event.key === "f") return release();
      const step = event.shiftKey ? 0.5 : 0.1;
      const moves = {
        ArrowUp: [0, step, 0], ArrowDown: [0, -step, 0], ArrowLeft: [-step, 0, 0],
        ArrowRight: [step, 0, 0], q: [0, 0, Math.PI / 12], e: [0, 0, -Math.PI / 12],
      };
      const move = moves[event.key];
      if (!move) return;
      event.preventDefault();
      event.stopPropagation();
      move.forEach((by, k) => { if (by) pose[k] = (pose[k] ?? reached) + by; });
      draw();
      onChange();
    });
    draw();
    return {
      pose,
      turned: (heading) => { reached = heading; draw(); },
      mark: (name) => marker.getElement().firstChild.className = `pin ${kind} ${name}`,
      remove: () => [marker, arrow, line].forEach((part) => part.remove()),
    };
  }

  // A path that a task drives along, with its number where it begins.
  row(label, points) {
    const line = L.polyline(points.map(([x, y]) => at(x, y)), { weight: 9, opacity: 0.45, interactive: false, className: "row" }).addTo(this.map);
    const icon = L.divIcon({ className: "", html: `<div class="pin task">${label}</div>`, iconSize: [26, 26] });
    const marker = L.marker(at(...points[0]), { icon, title: label, alt: t("path_of", { name: label }), interactive: false, keyboard: false }).addTo(this.map);
    const mark = (name) => {
      marker.getElement().firstChild.className = `pin task ${name}`;
      line.setStyle({ color: color(name === "out" ? "--bad" : name === "done" ? "--good" : "--least") });
    };
    mark("");
    return { pose: null, mark, remove: () => [marker, line].forEach((part) => part.remove()) };
  }

  // Areas in reach, one in the other: what little leads to is darkest.
  areas(document_, label) {
    this.reach.clearLayers();
    L.geoJSON(document_, {
      coordsToLatLng: ([x, y]) => at(x, y), interactive: false,
      style: () => ({ color: color("--least"), weight: 1, fillOpacity: 0.09 }),
      onEachFeature: (feature, layer) => {
        const north = layer.getLatLngs().flat(Infinity).reduce((a, b) => (b.lat > a.lat ? b : a));
        L.tooltip(north, { permanent: true, direction: "bottom", className: "energy",
          content: label(feature.properties.energy) }).addTo(this.reach);
      },
    }).addTo(this.reach);
  }

  // Where robots are at a moment: points with their colours.
  where(points) {
    this.robots.clearLayers();
    for (const [x, y, tint] of points) {
      L.circleMarker(at(x, y), { radius: 18, weight: 3, fillOpacity: 0.3, interactive: false, className: "robot",
        color: tint.startsWith("--") ? color(tint) : tint }).addTo(this.robots);
    }
  }

  route(path, name, dashed = false) {
    L.polyline(path.map(([x, y]) => at(x, y)), {
      color: name.startsWith("--") ? color(name) : name, weight: dashed ? 3 : 4, dashArray: dashed ? "7 6" : null,
      interactive: false,
    }).addTo(this.routes);
  }
}

function place(marker) {
  const { lat, lng } = marker.getLatLng();
  return [lng, lat];
}
