// What lies round the picture: tools, views, objects and their settings, help.

import { colourOf, html, pathOf, replaceChildren, svg } from "./elements";
import type { History } from "./history";
import { percent, type Masking } from "./masking";
import type { Tool } from "./picture";
import { toPart, type Item, type Shape, type Size } from "./requests";
import { thumbnailOf } from "./server";

export const TOOLS: { tool: Tool; name: string; key: string; hint: string }[] = [
  { tool: "add", name: "Add", key: "A", hint: "click on the object; click on a point again to take it away" },
  { tool: "leave", name: "Leave out", key: "L", hint: "click beside the object; so does Shift with Add" },
  { tool: "box", name: "Box", key: "B", hint: "drag a box round the object; click inside it to take it away" },
  { tool: "brush", name: "Brush", key: "P", hint: "paint over the surface that is to go" },
  { tool: "sphere", name: "Sphere", key: "S", hint: "click on the surface in the middle of what is to go" },
];
const OTHER_KEYS: [string, string][] = [
  ["\u2190 \u2192, Page Up, Page Down", "the view before, the next"],
  ["Ctrl Z, Ctrl Shift Z", "undo, redo"],
  ["[ ]", "smaller, larger: sphere or brush"],
  ["N", "a new object"],
  ["Delete", "remove the object"],
  ["H", "hide and show masks"],
  ["Ctrl S", "save"],
  ["Arrow keys on the picture", "move a crosshair, with Shift further; Enter clicks, begins or ends a drag"],
];
const NAME = /^[a-z0-9][a-z0-9_-]{0,62}$/; // as the request's schema has it
const NAMES = "a name has small letters, digits, - and _, begins with none of the last two, and is no other object's.";

export function listTools(parent: HTMLElement, why: string | null, choose: (tool: Tool) => void): void {
  for (const { tool, name, key, hint } of TOOLS) {
    const button = html("button", { type: "button", "data-tool": tool, title: hint }, name, " ", html("kbd", {}, key));
    if (tool === "sphere" && why !== null) {
      button.disabled = true;
      button.title = why;
    }
    button.addEventListener("click", () => choose(tool));
    parent.append(button);
  }
}

export function markTool(parent: HTMLElement, chosen: Tool): void {
  for (const button of parent.querySelectorAll("button")) {
    button.setAttribute("aria-pressed", String(button.dataset.tool === chosen));
  }
}

/** The strip of views; returns what draws the masks on it. */
export function listViews(
  parent: HTMLElement,
  frames: { name: string; size: Size }[],
  choose: (index: number) => void,
): (current: number, items: Item[], masking: Masking) => void {
  const entries = frames.map(({ name, size }, index) => {
    const [width, height] = size;
    const masks = svg("svg", { viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true" });
    const image = html("img", { src: thumbnailOf(name), alt: "", loading: "lazy", width: "96", height: "72" });
    const doubt = html("strong", { class: "doubt" });
    const button = html("button", { type: "button" }, html("span", { class: "thumbnail" }, image, masks), name, doubt);
    button.addEventListener("click", () => choose(index));
    parent.append(html("li", {}, button));
    return { name, button, masks, doubt };
  });
  let before = -1;
  return (current, items, masking) => {
    entries.forEach(({ name, button, masks, doubt }, index) => {
      doubt.textContent = masking.isDoubtful(name) ? "look at it" : "";
      if (index === current) button.setAttribute("aria-current", "true");
      else button.removeAttribute("aria-current");
      masks.replaceChildren(
        ...items.map((item) =>
          svg("path", {
            d: pathOf(masking.outline(item, name)),
            class: `mask ${colourOf(item.id)}${masking.isStale(item) ? " stale" : ""}`,
            "fill-rule": "evenodd",
          }),
        ),
      );
    });
    const middle = entries[current]!.button;
    const left = middle.offsetLeft - parent.offsetLeft - (parent.clientWidth - middle.offsetWidth) / 2;
    if (current !== before) parent.scrollTo({ left });
    before = current;
  };
}

export function listObjects(
  parent: HTMLElement,
  history: History,
  masking: Masking,
  view: string,
  say: (error: string) => void,
): void {
  if (parent.querySelector("input")) return; // somebody writes a name
  const { items, active } = history.state;
  replaceChildren(
    parent,
    ...items.map((item) => {
      const share = masking.share(item, view);
      const what = share === null ? describe(item.shape) : `${describe(item.shape)}, ${percent(share)} of this view`;
      const swatch = html("span", { class: `swatch ${colourOf(item.id)}` });
      const text = html("span", {}, item.name, html("small", {}, what));
      const choose = html("button", { type: "button", class: "choose", "data-key": `choose ${item.id}` }, swatch, text);
      if (item.id === active) choose.setAttribute("aria-current", "true");
      choose.addEventListener("click", () => history.choose(item.id));
      const named = (what: string) => {
        return { type: "button", "aria-label": `${what} ${item.name}`, "data-key": `${what} ${item.id}` };
      };
      const rename = html("button", named("Rename"), "Rename");
      rename.addEventListener("click", () => askName(item, history, rename.parentElement!, say));
      const remove = html("button", named("Remove"), "Remove");
      remove.addEventListener("click", () => history.remove(item.id));
      return html("li", {}, choose, html("span", { class: "row" }, rename, remove));
    }),
  );
}

function askName(item: Item, history: History, row: HTMLElement, say: (error: string) => void): void {
  const field = html("input", { value: item.name, "aria-label": `Name of ${item.name}`, maxlength: "63" });
  let left = false;
  const leave = (name: string) => {
    if (left) return;
    left = true;
    const taken = history.state.items.some((other) => other.id !== item.id && other.name === name);
    field.remove();
    if (name !== item.name && NAME.test(name) && !taken) return history.rename(item.id, name);
    if (name !== item.name) say(`${name}: ${NAMES}`);
    history.choose(history.state.active);
  };
  field.addEventListener("blur", () => leave(field.value.trim()));
  field.addEventListener("keydown", (event) => {
    if (event.key === "Enter") leave(field.value.trim());
    if (event.key === "Escape") leave(item.name);
    event.stopPropagation();
  });
  row.replaceChildren(field);
  field.focus();
  field.select();
}

/** Sliders for the active object, and how far all masks are grown. */
export function listSettings(parent: HTMLElement, history: History): void {
  const { shape } = history.active;
  const rows = [
    slider("Grow masks by", "of the shorter side", history.state.dilate, 0, 0.06, (value) => history.setDilate(value)),
  ];
  if (shape?.kind === "sphere") {
    const set = (radius: number) => history.setShape({ ...shape, radius });
    rows.unshift(slider("Radius", "of the distance", shape.radius, 0.01, 0.6, set));
  }
  if (shape?.kind === "scribble") {
    const set = (thickness: number) => history.setShape({ ...shape, thickness });
    rows.unshift(slider("Brush", "of the shorter side", shape.thickness, 0.005, 0.3, set));
  }
  replaceChildren(parent, ...rows);
}

/** The shape with its one size changed by a factor; null where it has none. */
export function resize(shape: Shape | null, factor: number): Shape | null {
  const round = (size: number) => Math.round(1000 * Math.min(1, size)) / 1000;
  if (shape?.kind === "sphere") return { ...shape, radius: round(shape.radius * factor) };
  if (shape?.kind === "scribble") return { ...shape, thickness: round(shape.thickness * factor) };
  return null;
}

function slider(
  name: string, unit: string, value: number, low: number, high: number, set: (value: number) => void,
): HTMLElement {
  const range = { type: "range", min: String(low), max: String(high), step: "0.001", value: String(value) };
  const input = html("input", { ...range, "data-key": name });
  const shown = html("span", {}, percent(value)); // an output would be what the label is of
  input.addEventListener("input", () => shown.replaceChildren(percent(Number(input.value))));
  input.addEventListener("change", () => set(Number(input.value)));
  return html("label", {}, html("span", {}, `${name} `, shown, ` ${unit}`), input);
}

function describe(shape: Shape | null): string {
  if (shape === null) return "nothing yet";
  if (shape.kind === "sphere") return "sphere";
  if (shape.kind === "given") return `${shape.part.kind}, as it was written`;
  if (shape.kind === "scribble") return `${shape.strokes.length} ${shape.strokes.length === 1 ? "stroke" : "strokes"}`;
  const count = shape.prompts.reduce((sum, p) => sum + p.points.length + p.background.length, 0);
  const boxes = shape.prompts.some((p) => p.box) ? ", box" : "";
  return toPart(shape, new Map()) === null ? "nothing to find yet" : `${count} points${boxes}`;
}

export function writeHelp(parent: HTMLElement): void {
  const tools = TOOLS.map(({ name, key, hint }): [string, string] => [key, `${name}: ${hint}`]);
  for (const [keys, what] of [...tools, ...OTHER_KEYS]) {
    parent.append(html("div", { class: "keys" }, html("kbd", {}, keys), html("span", {}, what)));
  }
}
