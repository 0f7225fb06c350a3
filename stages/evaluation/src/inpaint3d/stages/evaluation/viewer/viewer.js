"use strict";
// Renders come from the field itself, coarse while the camera moves, finer while it rests.
const WIDTHS = [120, 320, 640];
const $ = (id) => document.getElementById(id);
const [stage, under, over, status] = ["stage", "under", "over", "status"].map($);
const session = Math.random().toString(36).slice(2);
let scene, camera, centre, view, order = 0, resting;

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, s = 1) => a.map((v, i) => v + s * b[i]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((v) => v / Math.hypot(...a));
const column = (pose, i) => [pose[i], pose[4 + i], pose[8 + i]];

// Rodrigues: a vector turned about a unit axis.
const turn = (v, axis, angle) => {
  const c = Math.cos(angle), s = Math.sin(angle), along = dot(axis, v) * (1 - c);
  return plus(plus(v.map((x) => x * c), cross(axis, v), s), axis, along);
};

const choose = (name) => {
  camera = scene.cameras.find((c) => c.name === name);
  const place = column(camera.pose, 3), ahead = column(camera.pose, 2);
  // The world's origin is the point of interest; the camera turns about what it sees at that distance.
  const reach = Math.max(0.05, -dot(place, ahead));
  centre = plus(place, ahead, reach);
  view = { place, axes: [0, 1, 2].map((i) => column(camera.pose, i)), moved: false };
  stage.style.aspectRatio = `${1} / ${camera.aspect}`;
  draw();
};

const orbit = (right, up) => {
  const rotate = (v) => turn(turn(v, [0, 0, 1], -right), view.axes[0], up);
  view.place = plus(centre, rotate(plus(view.place, centre, -1)));
  view.axes = view.axes.map(rotate).map(unit);
  view.moved = true;
  draw();
};

const zoom = (factor) => {
  view.place = plus(centre, plus(view.place, centre, -1), factor);
  view.moved = true;
  draw();
};

const numbers = () => {
  const rows = [0, 1, 2].flatMap((r) => [...view.axes.map((a) => a[r]), view.place[r]]);
  return [...rows, camera.focal, camera.aspect].map((v) => v.toFixed(6)).join(",");
};

// What a side shows: a photo as a file of its camera, all else as a render.
const address = (what, width, turnNumber) => {
  if (what === "photo" || what === "masked") return `${what}/${encodeURIComponent(camera.name)}`;
  const [name, map] = what.split(" ");
  return `render/${name}/${map}/${width}/${session}/${turnNumber}/${numbers()}`;
};

const load = async (image, what, width, turnNumber) => {
  const answer = await fetch(address(what, width, turnNumber));
  if (answer.status !== 200) return; // 204: a later picture was asked for
  const bytes = new Uint8Array(await answer.arrayBuffer());
  if (turnNumber < order) return;
  const url = URL.createObjectURL(new Blob([bytes], { type: "image/jpeg" }));
  const old = image.src;
  image.src = url;
  image.dataset.width = width;
  if (old.startsWith("blob:")) URL.revokeObjectURL(old);
};

const draw = () => {
  clearTimeout(resting);
  const mine = ++order;
  for (const image of [over, under]) delete image.dataset.width;
  const photos = [$("left").value, $("right").value].some((w) => w === "photo" || w === "masked");
  const step = async (level) => {
    if (mine < order || level >= WIDTHS.length) return;
    await load(over, $("left").value, WIDTHS[level], mine);
    await load(under, $("right").value, WIDTHS[level], mine);
    if (mine < order) return;
    status.textContent = `${camera.name}${camera.split === "test" ? " (kept out of training)" : ""}${view.moved ? ", moved" : ""}, ${WIDTHS[level]} pixels wide${photos && view.moved ? "; photos are seen from their own camera" : ""}`;
    resting = setTimeout(() => step(level + 1), 120);
  };
  step(0);
};

const begin = async () => {
  scene = await (await fetch("scene.json")).json();
  document.title = `${scene.title} · inpaint3d viewer`;
  $("title").textContent = scene.title;
  const shows = scene.fields.flatMap((name) => scene.maps.map((map) => [`${name} ${map}`, `${name}, ${map}`]));
  shows.push(["photo", "photo"], ["masked", "photo with its mask"]);
  for (const id of ["left", "right"]) for (const [value, text] of shows) $(id).add(new Option(text, value));
  $("left").value = scene.fields.includes("original") ? "original colour" : "photo";
  $("right").value = `${scene.fields[0]} colour`;
  for (const c of scene.cameras) $("camera").add(new Option(c.split === "test" ? `${c.name} (test)` : c.name, c.name));
  for (const id of ["left", "right"]) $(id).addEventListener("change", draw);
  $("camera").addEventListener("change", () => choose($("camera").value));
  $("back").addEventListener("click", () => choose(camera.name));
  $("at").addEventListener("input", () => stage.style.setProperty("--at", `${$("at").value}%`));
  choose(scene.cameras[0].name);
};

let held = null;
stage.addEventListener("pointerdown", (event) => {
  held = [event.clientX, event.clientY];
  stage.setPointerCapture(event.pointerId);
});
stage.addEventListener("pointermove", (event) => {
  if (!held) return;
  orbit((event.clientX - held[0]) / 200, (event.clientY - held[1]) / 200);
  held = [event.clientX, event.clientY];
});
stage.addEventListener("pointerup", () => (held = null));
stage.addEventListener("wheel", (event) => {
  event.preventDefault();
  zoom(Math.exp(event.deltaY / 800));
}, { passive: false });
const KEYS = {
  ArrowLeft: () => orbit(-0.08, 0), ArrowRight: () => orbit(0.08, 0),
  ArrowUp: () => orbit(0, -0.06), ArrowDown: () => orbit(0, 0.06),
  "+": () => zoom(0.9), "=": () => zoom(0.9), "-": () => zoom(1.1),
};
stage.addEventListener("keydown", (event) => {
  if (!KEYS[event.key]) return;
  event.preventDefault();
  KEYS[event.key]();
});

begin();
