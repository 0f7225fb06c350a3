// The picture that is pointed at: masks and marks over it, the pointer, and a crosshair for the keyboard.

import { colourOf, pathOf, svg } from "./elements";
import type { Box, Item, Pixel, Size } from "./requests";
import { pictureOf, type Outline } from "./server";

export type Tool = "add" | "leave" | "box" | "brush" | "sphere";

export interface Gestures {
  click: (at: Pixel, away: boolean) => void;
  drag: (path: Pixel[]) => void;
}

const CLICK = 4; // pixels of the screen; less of a movement is a click
const STEP = 0.01; // of the shorter side, by an arrow key
const KEYS: Record<string, Pixel> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export class Picture {
  tool: Tool = "add";
  private readonly root = svg("svg", { tabindex: 0, role: "application", preserveAspectRatio: "xMidYMid meet" });
  private readonly image = svg("image");
  private readonly masks = svg("g");
  private readonly marks = svg("g");
  private readonly drawn = svg("g", { class: "drawn" });
  private readonly crosshair = svg("path", { class: "crosshair" });
  private size: Size = [1, 1];
  private cursor: Pixel = [0, 0];
  private path: Pixel[] | null = null;
  private name = "";

  constructor(parent: HTMLElement, private readonly gestures: Gestures) {
    this.root.append(this.image, this.masks, this.marks, this.drawn, this.crosshair);
    parent.append(this.root);
    this.root.addEventListener("pointerdown", (event) => this.begin(event));
    this.root.addEventListener("pointermove", (event) => this.go(event));
    this.root.addEventListener("pointerup", (event) => this.end(event));
    this.root.addEventListener("pointercancel", () => this.drop());
    this.root.addEventListener("keydown", (event) => this.press(event));
  }

  show(name: string, size: Size): void {
    if (name === this.name) return;
    this.drop();
    [this.name, this.size] = [name, size];
    const [width, height] = size;
    this.cursor = [width / 2, height / 2];
    this.root.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.root.setAttribute(
      "aria-label",
      `View ${name}. Arrow keys move a crosshair, with Shift further; Enter is a click, and begins or ends a drag.`,
    );
    this.image.setAttribute("href", pictureOf(name));
    this.image.setAttribute("width", String(width));
    this.image.setAttribute("height", String(height));
    this.drawCrosshair();
  }

  /** Draw masks and marks anew. Sizes on the screen do not depend on the picture's. */
  draw(items: Item[], active: Item, view: string, outlines: { item: Item; outline: Outline; stale: boolean }[]): void {
    this.masks.replaceChildren(
      ...outlines.map(({ item, outline, stale }) =>
        svg("path", {
          d: pathOf(outline),
          class: `mask ${colourOf(item.id)}${stale ? " stale" : ""}${item.id === active.id ? " active" : ""}`,
          "fill-rule": "evenodd",
          "data-object": item.name,
        }),
      ),
    );
    this.marks.replaceChildren(...items.flatMap((item) => this.marksOf(item, view, item.id === active.id)));
  }

  /** Whether two places are one for a person's finger. */
  isNear(one: Pixel, other: Pixel): boolean {
    return Math.hypot(one[0] - other[0], one[1] - other[1]) <= 7 * this.unit();
  }

  private marksOf(item: Item, view: string, active: boolean): SVGElement[] {
    const { shape } = item;
    const kind = `${colourOf(item.id)}${active ? " active" : ""}`;
    if (shape?.kind === "scribble") {
      return shape.strokes
        .filter((stroke) => stroke.view === view)
        .map(({ path }) => svg("path", { d: `M${path.map((xy) => xy.join(" ")).join("L")}`, class: `stroke ${kind}` }));
    }
    if (shape?.kind === "sphere") return shape.view === view ? [this.dot(shape.at, false, kind)] : [];
    const prompts = shape?.kind === "object" ? shape.prompts.find((p) => p.view === view) : undefined;
    if (prompts === undefined) return [];
    const marks: SVGElement[] = [
      ...prompts.points.map((xy) => this.dot(xy, false, kind)),
      ...prompts.background.map((xy) => this.dot(xy, true, kind)),
    ];
    if (prompts.box) marks.push(rectangle(prompts.box, `box ${kind}`));
    return marks;
  }

  private dot([x, y]: Pixel, away: boolean, kind: string): SVGElement {
    const [radius, arm] = [6 * this.unit(), 3 * this.unit()];
    return svg(
      "g",
      { class: `point ${away ? "away" : "on"} ${kind}` },
      svg("circle", { cx: x, cy: y, r: radius }),
      svg("path", { d: `M${x - arm} ${y}h${2 * arm}${away ? "" : `M${x} ${y - arm}v${2 * arm}`}` }),
    );
  }

  /** Pixels of the picture in one of the screen. */
  private unit(): number {
    return this.size[0] / Math.max(1, this.image.getBoundingClientRect().width);
  }

  private at(event: PointerEvent): Pixel {
    const matrix = this.root.getScreenCTM()!.inverse();
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix);
    return this.inside([x, y]);
  }

  /** Moved into the picture; to a tenth of a pixel. */
  private inside([x, y]: Pixel): Pixel {
    const clip = (v: number, side: number) => Math.round(10 * Math.min(Math.max(v, 0), side - 0.1)) / 10;
    return [clip(x, this.size[0]), clip(y, this.size[1])];
  }

  private begin(event: PointerEvent): void {
    if (event.button !== 0) return;
    event.preventDefault();
    this.root.setPointerCapture(event.pointerId);
    this.root.focus({ preventScroll: true });
    this.root.classList.add("pointed"); // the pointer is its own crosshair
    this.path = [this.at(event)];
  }

  private go(event: PointerEvent): void {
    if (this.path === null || !this.root.hasPointerCapture(event.pointerId)) return;
    this.path.push(this.at(event));
    this.drawPath();
  }

  private end(event: PointerEvent): void {
    if (this.path === null) return;
    this.cursor = this.path.at(-1)!;
    this.finish(event.shiftKey);
  }

  private finish(away: boolean): void {
    const path = this.path!;
    this.drop();
    this.drawCrosshair();
    const [first, last] = [path[0]!, path.at(-1)!];
    const far = path.some((xy) => Math.hypot(xy[0] - first[0], xy[1] - first[1]) > CLICK * this.unit());
    if (this.isDragged() && far) this.gestures.drag(path);
    else this.gestures.click(far ? first : last, away);
  }

  private isDragged(): boolean {
    return this.tool === "box" || this.tool === "brush";
  }

  private drop(): void {
    this.path = null;
    this.drawn.replaceChildren();
  }

  private press(event: KeyboardEvent): void {
    const step = KEYS[event.key];
    if (step !== undefined) {
      const far = STEP * Math.min(...this.size) * (event.shiftKey ? 5 : 1);
      this.cursor = this.inside([this.cursor[0] + far * step[0], this.cursor[1] + far * step[1]]);
      this.path?.push(this.cursor);
      this.drawPath();
    } else if (event.key === "Enter" || event.key === " ") {
      if (this.path === null && this.isDragged()) this.path = [this.cursor];
      else {
        this.path ??= [this.cursor];
        this.finish(event.shiftKey);
      }
    } else if (event.key === "Escape" && this.path !== null) this.drop();
    else return;
    event.preventDefault();
    event.stopPropagation();
    this.root.classList.remove("pointed");
    this.drawCrosshair();
  }

  private drawPath(): void {
    if (this.path === null || !this.isDragged()) return;
    const [first, last] = [this.path[0]!, this.path.at(-1)!];
    const line = `M${this.path.map((xy) => xy.join(" ")).join("L")}`;
    this.drawn.replaceChildren(this.tool === "box" ? rectangle(boxOf([first, last]), "") : svg("path", { d: line }));
  }

  private drawCrosshair(): void {
    const [x, y] = this.cursor;
    const [near, far] = [4 * this.unit(), 14 * this.unit()];
    const arm = far - near;
    this.crosshair.setAttribute(
      "d",
      `M${x - far} ${y}h${arm}M${x + near} ${y}h${arm}M${x} ${y - far}v${arm}M${x} ${y + near}v${arm}`,
    );
  }
}

/** The upright box round a path's ends. */
export function boxOf(path: Pixel[]): Box {
  const [a, b] = [path[0]!, path.at(-1)!];
  return [Math.min(a[0], b[0]), Math.min(a[1], b[1]), Math.max(a[0], b[0]), Math.max(a[1], b[1])];
}

function rectangle([x0, y0, x1, y1]: Box, kind: string): SVGElement {
  return svg("rect", { x: x0, y: y0, width: x1 - x0, height: y1 - y0, class: kind });
}
