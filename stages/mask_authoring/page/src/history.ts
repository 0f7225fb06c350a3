// The objects and which of them is worked on, with every state before and after.

import { DILATE, RADIUS, THICKNESS, isEmpty, type Box, type Item, type Pixel, type Prompts, type Shape } from "./requests";

export interface State {
  items: Item[];
  active: number;
  dilate: number;
}

export class History {
  state: State = { items: [{ id: 1, name: "object-1", shape: null }], active: 1, dilate: DILATE };
  private past: State[] = [];
  private future: State[] = [];

  constructor(private readonly changed: () => void) {}

  get active(): Item {
    return this.state.items.find((item) => item.id === this.state.active) ?? this.state.items[0]!;
  }
  get canUndo(): boolean {
    return this.past.length > 0;
  }
  get canRedo(): boolean {
    return this.future.length > 0;
  }

  /** Begin with what was saved: there is nothing before it. */
  load(items: Item[], dilate: number): void {
    this.state = { items, active: items[0]!.id, dilate };
    this.changed();
  }

  undo(): void {
    const before = this.past.pop();
    if (before === undefined) return;
    this.future.push(this.state);
    this.state = before;
    this.changed();
  }

  redo(): void {
    const after = this.future.pop();
    if (after === undefined) return;
    this.past.push(this.state);
    this.state = after;
    this.changed();
  }

  add(): void {
    const id = Math.max(0, ...this.state.items.map((item) => item.id)) + 1;
    const item = { id, name: this.freeName(), shape: null };
    this.commit({ ...this.state, items: [...this.state.items, item], active: id });
  }

  remove(id: number): void {
    const items = this.state.items.filter((item) => item.id !== id);
    if (items.length === 0) items.push({ id: id + 1, name: "object-1", shape: null });
    const active = items.some((item) => item.id === this.state.active) ? this.state.active : items.at(-1)!.id;
    this.commit({ ...this.state, items, active });
  }

  rename(id: number, name: string): void {
    this.commit({ ...this.state, items: this.state.items.map((item) => (item.id === id ? { ...item, name } : item)) });
  }

  /** Work on another object; no step of its own to take back. */
  choose(id: number): void {
    this.state = { ...this.state, active: id };
    this.changed();
  }

  setDilate(dilate: number): void {
    this.commit({ ...this.state, dilate });
  }

  /** Change what the active object is; where it is of another kind already, a new object is begun. */
  setShape(shape: Shape): void {
    const { active } = this;
    if (active.shape !== null && active.shape.kind !== shape.kind) {
      const id = Math.max(...this.state.items.map((item) => item.id)) + 1;
      const items = [...this.state.items, { id, name: this.freeName(), shape }];
      this.commit({ ...this.state, items, active: id });
      return;
    }
    const items = this.state.items.map((item) => (item.id === active.id ? { ...item, shape } : item));
    this.commit({ ...this.state, items });
  }

  addPoint(view: string, at: Pixel, where: "points" | "background"): void {
    this.setPrompts(view, (prompts) => ({ ...prompts, [where]: [...prompts[where], at] }));
  }

  setBox(view: string, box: Box): void {
    this.setPrompts(view, (prompts) => ({ ...prompts, box }));
  }

  /** Take away the active object's point at a place of a view; false where there is none. */
  removePoint(view: string, near: (xy: Pixel) => boolean): boolean {
    const { shape } = this.active;
    const prompts = shape?.kind === "object" ? shape.prompts.find((p) => p.view === view) : undefined;
    for (const where of ["points", "background"] as const) {
      const index = prompts?.[where].findLastIndex(near) ?? -1;
      if (index >= 0) {
        this.setPrompts(view, (p) => ({ ...p, [where]: p[where].toSpliced(index, 1) }));
        return true;
      }
    }
    return false;
  }

  removeBox(view: string): void {
    this.setPrompts(view, (prompts) => ({ ...prompts, box: null }));
  }

  addStroke(view: string, path: Pixel[]): void {
    const { shape } = this.active;
    const before = shape?.kind === "scribble" ? shape : { strokes: [], thickness: THICKNESS };
    this.setShape({ kind: "scribble", strokes: [...before.strokes, { view, path }], thickness: before.thickness });
  }

  /** A sphere round a place on the surface; one that is there keeps its radius. */
  putSphere(view: string, at: Pixel): void {
    const { shape } = this.active;
    this.setShape({ kind: "sphere", view, at, radius: shape?.kind === "sphere" ? shape.radius : RADIUS });
  }

  private setPrompts(view: string, change: (prompts: Prompts) => Prompts): void {
    const { shape } = this.active;
    const all = shape?.kind === "object" ? shape.prompts : [];
    const before = all.find((p) => p.view === view) ?? { view, points: [], background: [], box: null };
    const others = all.filter((p) => p.view !== view);
    const after = change(before);
    const kept = isEmpty(after) && after.background.length === 0 ? others : [...others, after];
    this.setShape({ kind: "object", prompts: kept });
  }

  private freeName(): string {
    const taken = new Set(this.state.items.map((item) => item.name));
    let number = 1;
    while (taken.has(`object-${number}`)) number += 1;
    return `object-${number}`;
  }

  private commit(state: State): void {
    this.past.push(this.state);
    this.future = [];
    this.state = state;
    this.changed();
  }
}
