// The page: objects on one side, the server on the other, and what a person does in between.

import { byId } from "./elements";
import { History } from "./history";
import { Masking } from "./masking";
import { listPainted } from "./painted";
import { TOOLS, listObjects, listSettings, listTools, listViews, markTool, resize, writeHelp } from "./panels";
import { Picture, boxOf, type Tool } from "./picture";
import { fromRequest, toRequest, viewsOf, type Pixel, type Size } from "./requests";
import { askScene, save, type Scene } from "./server";

const NO_SPHERE = "A sphere needs the field's depth.";

class Page {
  private readonly sizes: Map<string, Size>;
  private readonly history = new History(() => this.refresh());
  private readonly masking: Masking;
  private readonly picture: Picture;
  private readonly drawStrip: ReturnType<typeof listViews>;
  private current = 0;

  constructor(private readonly scene: Scene) {
    this.sizes = new Map(scene.frames.map(({ name, size }) => [name, size]));
    this.masking = new Masking(this.sizes, scene.missing === null, {
      status: (text) => say("status", text),
      error: (text) => say("error", text),
      changed: () => this.draw(),
    });
    this.picture = new Picture(byId("picture"), {
      click: (at, away) => this.click(at, away),
      drag: (path) => this.drag(path),
    });
    listTools(byId("tools"), scene.missing === null ? null : NO_SPHERE, (tool) => this.choose(tool));
    this.drawStrip = listViews(byId("strip"), scene.frames, (index) => this.go(index));
    writeHelp(byId("helptext"));
    this.listen();
    this.begin();
  }

  private get view(): string {
    return this.scene.frames[this.current]!.name;
  }

  private begin(): void {
    const { title, missing, finder, saved, problem, painted } = this.scene;
    byId("title").textContent = title;
    document.title = `Masks: ${title}`;
    byId("missing").hidden = missing === null;
    byId("missing").textContent = missing ?? "";
    byId("finder").textContent = finder;
    if (painted !== null) listPainted(painted, (now) => this.tellSaved(now), (text) => say("error", text));
    this.choose("add");
    if (saved !== null) {
      const items = fromRequest(saved, this.sizes);
      const pointed = viewsOf(items[0]!.shape)[0];
      this.current = Math.max(0, this.scene.frames.findIndex((frame) => frame.name === pointed));
      this.history.load(items, saved.dilate);
    } else this.refresh();
    if (problem !== null) say("error", problem);
  }

  private choose(tool: Tool): void {
    if (tool === "sphere" && this.scene.missing !== null) return say("error", NO_SPHERE);
    this.picture.tool = tool;
    markTool(byId("tools"), tool);
    say("status", TOOLS.find((one) => one.tool === tool)!.hint);
  }

  private go(index: number): void {
    this.current = Math.min(Math.max(index, 0), this.scene.frames.length - 1);
    this.refresh();
  }

  private click(at: Pixel, away: boolean): void {
    const { view, history } = this;
    const { tool } = this.picture;
    if (tool === "sphere") history.putSphere(view, at);
    else if (tool === "brush") history.addStroke(view, [at]);
    else if (tool === "box") history.removeBox(view);
    else if (!history.removePoint(view, (xy) => this.picture.isNear(xy, at))) {
      history.addPoint(view, at, away || tool === "leave" ? "background" : "points");
    }
  }

  private drag(path: Pixel[]): void {
    if (this.picture.tool === "brush") this.history.addStroke(this.view, path);
    else this.history.setBox(this.view, boxOf(path));
  }

  /** After every change of the objects, and of the view. */
  private refresh(): void {
    const { items, dilate } = this.history.state;
    this.picture.show(this.view, this.sizes.get(this.view)!);
    this.masking.update(items, this.history.active, this.view, dilate);
    byId("name").textContent = `${this.view} (${this.current + 1} of ${this.scene.frames.length})`;
    byId<HTMLButtonElement>("previous").disabled = this.current === 0;
    byId<HTMLButtonElement>("next").disabled = this.current === this.scene.frames.length - 1;
    byId<HTMLButtonElement>("undo").disabled = !this.history.canUndo;
    byId<HTMLButtonElement>("redo").disabled = !this.history.canRedo;
    listSettings(byId("settings"), this.history);
    this.draw();
  }

  private draw(): void {
    const { items } = this.history.state;
    const shown = byId<HTMLInputElement>("shown").checked ? items : [];
    const outlines = shown.map((item) => ({
      item,
      outline: this.masking.outline(item, this.view),
      stale: this.masking.isStale(item),
    }));
    this.picture.draw(items, this.history.active, this.view, outlines);
    this.drawStrip(this.current, shown, this.masking);
    listObjects(byId("objects"), this.history, this.masking, this.view, (error) => say("error", error));
  }

  private async save(): Promise<void> {
    const { items, dilate } = this.history.state;
    const request = toRequest(items, this.sizes, dilate);
    if (request === null) return say("error", "There is nothing to save yet: point at something first.");
    try {
      this.tellSaved(await save(request));
    } catch (error) {
      say("error", (error as Error).message);
    }
  }

  private tellSaved({ file, then }: { file: string; then: string }): void {
    byId("file").textContent = file;
    byId("then").textContent = then;
    say("error", "");
    say("status", `saved in ${file}`);
    const box = byId<HTMLDialogElement>("savedbox");
    if (!box.open) box.showModal();
  }

  private resize(factor: number): void {
    const shape = resize(this.history.active.shape, factor);
    if (shape !== null) this.history.setShape(shape);
  }

  private listen(): void {
    const on = (id: string, act: () => void) => byId(id).addEventListener("click", act);
    on("undo", () => this.history.undo());
    on("redo", () => this.history.redo());
    on("new", () => this.history.add());
    on("save", () => void this.save());
    on("previous", () => this.go(this.current - 1));
    on("next", () => this.go(this.current + 1));
    on("help", () => byId<HTMLDialogElement>("helpbox").showModal());
    on("copy", () => void navigator.clipboard.writeText(byId("then").textContent ?? ""));
    byId("shown").addEventListener("change", () => this.draw());
    window.addEventListener("resize", () => this.draw());
    document.addEventListener("keydown", (event) => {
      if (!document.querySelector("dialog[open]") && this.press(event)) event.preventDefault();
    });
  }

  /** A shortcut; false where the key is none. */
  private press(event: KeyboardEvent): boolean {
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const writing = event.target instanceof HTMLInputElement && !["checkbox"].includes(event.target.type);
    if (event.ctrlKey || event.metaKey) {
      if (key === "z") event.shiftKey ? this.history.redo() : this.history.undo();
      else if (key === "y") this.history.redo();
      else if (key === "s") void this.save();
      else return false;
      return true;
    }
    if (writing || event.altKey) return false;
    if (key === "PageUp" || key === "ArrowLeft") this.go(this.current - 1);
    else if (key === "PageDown" || key === "ArrowRight") this.go(this.current + 1);
    else if (key === "Delete") this.history.remove(this.history.state.active);
    else if (byId<HTMLInputElement>("letters").checked) return this.pressLetter(key);
    else return false;
    return true;
  }

  private pressLetter(key: string): boolean {
    const tool = TOOLS.find((one) => one.key.toLowerCase() === key)?.tool;
    const shown = byId<HTMLInputElement>("shown");
    if (tool !== undefined) this.choose(tool);
    else if (key === "n") this.history.add();
    else if (key === "[") this.resize(1 / 1.15);
    else if (key === "]") this.resize(1.15);
    else if (key === "?") byId<HTMLDialogElement>("helpbox").showModal();
    else if (key === "h") {
      shown.checked = !shown.checked;
      this.draw();
    } else return false;
    return true;
  }
}

function say(where: "status" | "error", text: string): void {
  byId(where).textContent = text;
}

askScene().then(
  (scene) => new Page(scene),
  (error: Error) => say("error", error.message),
);
