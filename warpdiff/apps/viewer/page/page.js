// Script of the viewer's page. It sends the values of the controls and the camera to the server, together with a
// generation: a number that increases with every change. The server answers with pictures that have the generation of
// their request.

const byId = (id) => document.getElementById(id);
const stage = byId("stage"), canvas = byId("picture"), context = canvas.getContext("2d");
const STORAGE_KEY = "warpdiff view";

// ---- Vectors -------------------------------------------------------------------------------------------------------

const add = (a, b, k = 1) => a.map((x, i) => x + k * b[i]);
const scaled = (a, k) => a.map((x) => k * x);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const length = (a) => Math.hypot(...a);
const unit = (a) => scaled(a, 1 / length(a));
const clamp = (x, least, most) => Math.min(Math.max(x, least), most);
const radians = (deg) => (deg * Math.PI) / 180;

function turned(v, axis, angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return add(add(scaled(v, c), cross(axis, v), s), axis, dot(axis, v) * (1 - c));
}

// ---- Values of the controls, and requests --------------------------------------------------------------------------

const state = { values: {}, camera: null, probe: [0.5, 0.5] };
let generation = 0, moving = false, body = null, controls = [];

function store() {
  sessionStorage.setItem(STORAGE_KEY, JSON.stringify({ ...state, generation }));
}

function changed() {
  generation += 1;
  canvas.dataset.requested = generation;
  canvas.dataset.error = "";
  requestPicture();
}

// Requests a picture. In each frame that the browser displays, at most one request is sent.
let isScheduled = false;
function requestPicture() {
  if (isScheduled) return;
  isScheduled = true;
  requestAnimationFrame(() => {
    isScheduled = false;
    const aspect = clamp(stage.clientWidth / Math.max(stage.clientHeight, 1), 0.2, 5);
    send({ do: "draw", generation, values: state.values, camera: state.camera, probe: state.probe, aspect, moving });
    store();
    place();
  });
}

// ---- Connection to the server --------------------------------------------------------------------------------------

let socket = null;

function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function connect() {
  const address = new URL("socket", location.href);
  address.protocol = address.protocol.replace("http", "ws");
  address.search = location.search;
  socket = new WebSocket(address);
  socket.binaryType = "arraybuffer";
  socket.onmessage = (event) => {
    if (typeof event.data === "string") return receive(JSON.parse(event.data), null);
    const size = new DataView(event.data).getUint32(0, true);
    const message = JSON.parse(new TextDecoder().decode(new Uint8Array(event.data, 4, size)));
    return receive(message, event.data.slice(4 + size));
  };
  socket.onclose = (event) => {
    document.body.dataset.connected = "";
    notice(event.reason || "Disconnected from the server. Reconnecting …");
    setTimeout(connect, 1000);
  };
}

function receive(message, data) {
  const kinds = { hello, picture, map, file, preparing, progress, warning: report, error: report };
  kinds[message.kind]?.(message, data);
}

function hello(message) {
  document.body.dataset.connected = message.version;
  notice("");
  build(message.controls);
  // After a new connection, the page requests a picture of its current generation again, and the server counts the
  // stages of this generation from 0 again. Without this reset, the page would take the new picture for an older one,
  // and would not show the new picture.
  shown = [-1, -1];
  requestPicture();
}

function report(message) {
  if (message.generation !== undefined && message.generation !== generation) return;
  notice(message.text, message.kind === "warning");
  canvas.dataset.error = message.kind === "error" ? message.text : "";
}

function preparing(message) {
  if (message.generation === generation) notice(`Planning pictures with tolerance ${message.tolerance} …`, true);
}

function progress(message) {
  if (message.generation !== generation) return;
  byId("rate").textContent = `next picture: ${(100 * message.share).toFixed(0)} %`;
}

function notice(text, soft = false) {
  byId("notice").textContent = text;
  byId("notice").className = soft ? "soft" : "";
}

function file(message, data) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([data]));
  link.download = message.name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

// ---- Pictures ------------------------------------------------------------------------------------------------------

// Generation (number of the request) and stage (index among the pictures of decreasing tolerance) of the picture on the
// canvas. A picture that arrives later but is older is not shown.
let shown = [-1, -1];
const times = [];

async function picture(message, data) {
  const bitmap = await createImageBitmap(new Blob([data], { type: message.type })).finally(() => send({ do: "shown" }));
  if (message.generation < shown[0] || (message.generation === shown[0] && message.stage <= shown[1])) return;
  shown = [message.generation, message.stage];
  [canvas.width, canvas.height] = [bitmap.width, bitmap.height];
  context.drawImage(bitmap, 0, 0);
  bitmap.close();
  body = message.body;
  // A picture of an older generation may show another body than the one that is now selected. The camera of such a
  // picture is not suitable for the selected body and is not adopted.
  if (state.camera === null && message.generation === generation) {
    state.camera = message.camera;
    store();
  }
  showStatus(message);
  place();
}

function showStatus(message) {
  const now = performance.now();
  times.push(now);
  while (times.length > 1 && now - times[0] > 1000) times.shift();
  byId("rate").textContent = moving && times.length > 2
    ? `${(((times.length - 1) * 1000) / (now - times[0])).toFixed(1)} pictures/s` : "";
  const names = message.tolerance === null ? "preview, one sample per pixel" : `tolerance ${message.tolerance}`;
  const { width, height, error } = message;
  const errors = error
    ? `, estimated error ${error.median.toPrecision(2)} (median), ${error.p99.toPrecision(2)} (99th percentile)` : "";
  byId("quality").textContent = `${width} × ${height}, ${names}${errors}`;
  const ms = Object.entries(message.seconds).map(([name, s]) => `${name} ${(1000 * s).toFixed(0)}`);
  byId("timing").textContent = `server: ${ms.join(", ")} ms`;
  for (const name of ["plan", "python", "command"]) if (message[name]) byId(name).textContent = message[name];
  if (message.generation === generation) {
    notice("");
    canvas.dataset.error = "";
  }
  Object.assign(canvas.dataset, {
    generation: message.generation, stage: message.stage, last: message.last, tolerance: message.tolerance ?? "",
    count: Number(canvas.dataset.count ?? 0) + 1, seconds: JSON.stringify(message.seconds),
  });
}

async function map(message, data) {
  if (message.generation !== generation) return;
  const chart = byId("map").getContext("2d");
  chart.clearRect(0, 0, 192, 192);
  byId("view").toggleAttribute("hidden", !message.to_view);
  if (data) {
    const bitmap = await createImageBitmap(new Blob([data], { type: message.type }));
    chart.drawImage(bitmap, 0, 0, 192, 192);
  }
  if (message.to_view) {
    byId("view").setAttribute("cx", message.to_view[0]);
    byId("view").setAttribute("cy", -message.to_view[1]);
  }
  const text = (name, { theta_deg, phi_deg }) => `${name}: θ ${theta_deg.toFixed(1)}°, φ ${phi_deg.toFixed(1)}°`;
  const lines = Object.entries(message.angles ?? {}).map(([name, angles]) => text(name, angles));
  const caption = message.text ?? "reflectance for this light, in all view directions";
  byId("angles").textContent = [...lines, caption].join("\n");
  byId("angles").style.whiteSpace = "pre-line";
  byId("map").dataset.generation = message.generation;
  // The reflectance map is the last message that answers a request. The probe is the point that the user has clicked.
  // If only the probe has moved, the server sends a new map but no new picture. The picture on the canvas is still
  // valid, and it gets the generation of the request.
  canvas.dataset.generation = message.generation;
  if (message.at) probed = message.at;
  place();
}

// ---- Controls ------------------------------------------------------------------------------------------------------

const inputs = new Map();

function build(schemas) {
  controls = schemas;
  const form = byId("controls");
  form.replaceChildren();
  inputs.clear();
  const groups = new Map();
  for (const control of controls) {
    // A stored value that the control does not accept any more is replaced by the default.
    const stored = state.values[control.name];
    const fits = control.enum ? control.enum.includes(stored) : typeof stored === typeof control.default;
    state.values[control.name] = fits ? stored : control.default;
    const { group } = control["x-ui"];
    if (!groups.has(group)) {
      const fields = document.createElement("fieldset");
      fields.append(Object.assign(document.createElement("legend"), { textContent: group }));
      groups.set(group, fields);
      form.append(fields);
    }
    const make = control.enum ? choice : control.type === "boolean" ? toggle : number;
    groups.get(group).append(make(control));
  }
  for (const name of Object.keys(state.values)) if (!inputs.has(name)) delete state.values[name];
  update();
}

function labelled(control, ...parts) {
  const label = Object.assign(document.createElement("label"), { title: control.description });
  const { unit } = control["x-ui"];
  label.append(unit ? `${control.title} [${unit}]` : control.title, ...parts);
  return label;
}

function input(type, properties) {
  const element = document.createElement(type === "select" ? "select" : "input");
  if (type !== "select") element.type = type;
  return Object.assign(element, properties);
}

function set(name, value) {
  state.values[name] = value;
  // The camera was fitted to the previous body. It is reset, so that the server fits a camera to the new one.
  if (name === "mesh") state.camera = null;
  update();
  changed();
}

function choice(control) {
  const select = input("select", { id: `set-${control.name}` });
  for (const [index, text] of control["x-ui"].labels.entries()) select.append(new Option(text, index));
  select.onchange = () => set(control.name, control.enum[select.value]);
  const label = labelled(control, select);
  inputs.set(control.name, { label, show: (value) => (select.value = control.enum.indexOf(value)) });
  return label;
}

function toggle(control) {
  const box = input("checkbox", { id: `set-${control.name}` });
  box.onchange = () => set(control.name, box.checked);
  const label = labelled(control, box);
  inputs.set(control.name, { label, show: (value) => (box.checked = value) });
  return label;
}

function number(control) {
  const { minimum, maximum } = control, { step, log } = control["x-ui"];
  const position = (value) =>
    log ? Math.log(value / minimum) / Math.log(maximum / minimum) : (value - minimum) / (maximum - minimum);
  const at = (share) => (log ? minimum * (maximum / minimum) ** share : minimum + share * (maximum - minimum));
  const rounded = (value) => clamp(Number((Math.round(value / step) * step).toFixed(6)), minimum, maximum);
  const field = input("number", { id: `set-${control.name}`, min: minimum, max: maximum, step: "any" });
  const slider = input("range", { min: 0, max: 1, step: "any", ariaLabel: control.title });
  field.onchange = () => field.value !== "" && set(control.name, clamp(Number(field.value), minimum, maximum));
  // The browser sends "input" events while the slider is dragged, and one "change" event when the slider is released.
  slider.oninput = () => {
    moving = true;
    set(control.name, rounded(at(Number(slider.value))));
  };
  slider.onchange = slider.onpointerup = rest;
  const label = labelled(control, field, slider);
  inputs.set(control.name, {
    label,
    show: (value) => {
      field.value = value;
      slider.value = position(value);
    },
  });
  return label;
}

function update() {
  for (const control of controls) {
    const { label, show } = inputs.get(control.name);
    show(state.values[control.name]);
    const conditions = Object.entries(control["x-ui"].shown_if);
    label.hidden = !conditions.every(([name, values]) => values.includes(state.values[name]));
  }
}

function rest() {
  if (!moving) return;
  moving = false;
  requestPicture();
}

// ---- Camera and light, moved in the picture ------------------------------------------------------------------------

let probed = null;

function frame() {
  const { eye, target, up, fov_y_deg } = state.camera;
  const offset = add(eye, target, -1);
  const back = unit(offset);
  const right = unit(cross(up, back));
  const half = Math.tan(radians(fov_y_deg) / 2);
  return { eye, target, up: unit(up), offset, distance: length(offset), back, right, top: cross(back, right), half };
}

function toLight() {
  const [azimuth, elevation] = [radians(state.values.azimuth_deg), radians(state.values.elevation_deg)];
  return [Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation), Math.cos(elevation) * Math.cos(azimuth)];
}

// Radius of the sphere around the camera's target on which the handle of a directional light moves, as a fraction of
// half the picture's height. The handle of a point light is at the position of the light instead.
const HANDLE = 0.75;

function sphere(view) {
  if (state.values.light === "point" && body) {
    return { centre: body.centre, radius: state.values.distance * body.radius };
  }
  return { centre: view.target, radius: HANDLE * view.half * view.distance };
}

function projected(point, view) {
  const offset = add(point, view.eye, -1);
  const depth = -dot(offset, view.back);
  const size = stage.clientHeight / 2 / view.half / depth;
  const [x, y] = [dot(offset, view.right) * size, dot(offset, view.top) * size];
  return [stage.clientWidth / 2 + x, stage.clientHeight / 2 - y];
}

function place() {
  if (!state.camera) return;
  const view = frame(), light = toLight(), { centre, radius } = sphere(view);
  const [x, y] = projected(add(centre, light, radius), view);
  const [x0, y0] = projected(centre, view);
  const handle = byId("light");
  handle.setAttribute("cx", x);
  handle.setAttribute("cy", y);
  handle.classList.toggle("behind", dot(light, view.back) < 0);
  for (const name of ["light", "ray"]) byId(name).toggleAttribute("hidden", state.values.light === "none");
  for (const [name, value] of Object.entries({ x1: x0, y1: y0, x2: x, y2: y })) byId("ray").setAttribute(name, value);
  byId("probe").toggleAttribute("hidden", !probed);
  if (probed) {
    byId("probe").setAttribute("cx", probed[0] * stage.clientWidth);
    byId("probe").setAttribute("cy", probed[1] * stage.clientHeight);
  }
}

function orbit(dx, dy) {
  const view = frame();
  const turn = (-2 * Math.PI * dx) / stage.clientHeight;
  const angle = Math.acos(clamp(dot(view.back, view.up), -1, 1));
  // The camera cannot pass over the poles, where the line of sight would be parallel to the up vector.
  const tilt = clamp(angle - (Math.PI * dy) / stage.clientHeight, 0.02, Math.PI - 0.02) - angle;
  const offset = turned(turned(view.offset, view.right, tilt), view.up, turn);
  moved({ eye: add(view.target, offset) });
}

function pan(dx, dy) {
  const view = frame();
  const size = (2 * view.half * view.distance) / stage.clientHeight;
  const by = add(scaled(view.right, -dx * size), view.top, dy * size);
  moved({ eye: add(view.eye, by), target: add(view.target, by) });
}

function zoom(factor) {
  const view = frame(), radius = body?.radius ?? view.distance;
  const distance = clamp(view.distance * factor, 1e-3 * radius, 100 * radius);
  moved({ eye: add(view.target, view.back, distance) });
}

function moved(change) {
  Object.assign(state.camera, change);
  probed = null;
  changed();
}

function drag(event) {
  const view = frame(), box = stage.getBoundingClientRect();
  const size = (2 * view.half) / stage.clientHeight;
  const x = (event.clientX - box.left - stage.clientWidth / 2) * size;
  const y = (stage.clientHeight / 2 - (event.clientY - box.top)) * size;
  const ray = unit(add(add(scaled(view.right, x), view.top, y), view.back, -1));
  // The pointer's ray intersects the sphere on which the handle moves. The light is moved to the front or the back
  // intersection. If the ray misses the sphere, the light is moved to the nearest point of the sphere's outline.
  const { centre, radius } = sphere(view), offset = add(view.eye, centre, -1), near = -dot(offset, ray);
  const inside = near * near - dot(offset, offset) + radius ** 2;
  const wasOutside = handle.outside;
  handle.outside = inside < 0;
  if (wasOutside && !handle.outside) handle.front = !handle.front;
  const t = inside < 0 ? near : near + (handle.front ? -1 : 1) * Math.sqrt(inside);
  const light = unit(add(offset, ray, t));
  state.values.azimuth_deg = Number(((Math.atan2(light[0], light[2]) * 180) / Math.PI).toFixed(2));
  state.values.elevation_deg = Number(((Math.asin(clamp(light[1], -1, 1)) * 180) / Math.PI).toFixed(2));
  update();
  changed();
}

const handle = { front: true, outside: false };
byId("light").onpointerdown = (event) => {
  handle.front = dot(toLight(), frame().back) >= 0;
  handle.outside = false;
  moving = true;
  event.target.setPointerCapture(event.pointerId);
  event.preventDefault();
};
byId("light").onpointermove = (event) => event.target.hasPointerCapture(event.pointerId) && drag(event);
byId("light").onpointerup = byId("light").onpointercancel = rest;

// One finger or the mouse rotates the camera around its target, or pans it. Two fingers pan and zoom.
const pointers = new Map();
let walked = 0;

canvas.onpointerdown = (event) => {
  if (!state.camera) return;
  pointers.set(event.pointerId, [event.clientX, event.clientY]);
  canvas.setPointerCapture(event.pointerId);
  canvas.classList.add("dragged");
  walked = 0;
};
canvas.onpointermove = (event) => {
  const before = pointers.get(event.pointerId);
  if (!before) return;
  const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
  walked += Math.abs(dx) + Math.abs(dy);
  if (walked < 3) return;
  moving = true;
  if (pointers.size > 1) {
    const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
    const apart = (to) => Math.hypot(to[0] - other[0], to[1] - other[1]);
    zoom(apart(before) / Math.max(apart([event.clientX, event.clientY]), 1));
    pan(dx / 2, dy / 2);
  } else if (event.shiftKey || event.buttons & 6) pan(dx, dy);
  else orbit(dx, dy);
  pointers.set(event.pointerId, [event.clientX, event.clientY]);
};
canvas.onpointerup = canvas.onpointercancel = (event) => {
  // A click without a movement sets the probe: the point on the body at which the page shows the local directions.
  if (pointers.delete(event.pointerId) && walked < 3 && event.type === "pointerup") {
    const box = stage.getBoundingClientRect();
    const at = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    state.probe = at.map((x) => clamp(x, 0, 1));
    changed();
  }
  if (pointers.size) return;
  canvas.classList.remove("dragged");
  rest();
};
canvas.oncontextmenu = (event) => event.preventDefault();

let wheeled = 0;
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  if (!state.camera) return;
  moving = true;
  zoom(Math.exp(clamp(event.deltaY, -200, 200) * 0.0015));
  clearTimeout(wheeled);
  wheeled = setTimeout(rest, 150);
}, { passive: false });

canvas.onkeydown = (event) => {
  const step = 24;
  const keys = {
    ArrowLeft: () => orbit(step, 0), ArrowRight: () => orbit(-step, 0), ArrowUp: () => orbit(0, step),
    ArrowDown: () => orbit(0, -step), "+": () => zoom(1 / 1.1), "-": () => zoom(1.1),
  };
  if (!state.camera || !keys[event.key]) return;
  event.preventDefault();
  keys[event.key]();
};

byId("reset").onclick = () => {
  state.camera = null;
  probed = null;
  changed();
};
for (const kind of ["png", "exr"]) byId(kind).onclick = () => send({ do: "save", as: kind });
for (const button of document.querySelectorAll("[data-copies]")) {
  button.onclick = () => navigator.clipboard?.writeText(byId(button.dataset.copies).textContent);
}
byId("controls").onsubmit = (event) => event.preventDefault();
new ResizeObserver(() => controls.length && changed()).observe(stage);

try {
  const stored = JSON.parse(sessionStorage.getItem(STORAGE_KEY)) ?? {};
  const { values = {}, camera = null, probe = [0.5, 0.5] } = stored;
  Object.assign(state, { values, camera, probe });
  canvas.dataset.requested = generation = stored.generation ?? 0;
} catch {
  sessionStorage.removeItem(STORAGE_KEY);
}
connect();
