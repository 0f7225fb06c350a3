// What a person has pointed at, and the mask request (schemas/artifacts/mask-request) that says the same.

export type Pixel = [number, number];
export type Box = [number, number, number, number];
export type Size = [number, number];

export interface Prompts {
  view: string;
  points: Pixel[];
  background: Pixel[];
  box: Box | null;
}
export interface Stroke {
  view: string;
  path: Pixel[];
}
export type Shape =
  | { kind: "object"; prompts: Prompts[] }
  | { kind: "scribble"; strokes: Stroke[]; thickness: number }
  | { kind: "sphere"; view: string; at: Pixel; radius: number } // radius: as a share of the depth at the click
  | { kind: "given"; part: Part }; // what was written by hand in a way that this page shows, but does not change

export interface Item {
  id: number;
  name: string;
  shape: Shape | null;
}

// A part of a request, as the server knows it.
export type Part = { kind: string } & Record<string, unknown>;
export interface MaskRequest {
  mask: Part;
  dilate: number;
}

export const DILATE = 0.015;
export const THICKNESS = 0.05;
export const RADIUS = 0.12;

export function isEmpty(prompts: Prompts): boolean {
  return prompts.points.length === 0 && prompts.box === null;
}

/** The views that were pointed at. */
export function viewsOf(shape: Shape | null): string[] {
  if (shape?.kind === "object") return shape.prompts.map((prompts) => prompts.view);
  if (shape?.kind === "scribble") return [...new Set(shape.strokes.map((stroke) => stroke.view))];
  return shape?.kind === "sphere" ? [shape.view] : [];
}

/** An object's part of the request; null while there is too little to ask for. */
export function toPart(shape: Shape | null, sizes: Map<string, Size>): Part | null {
  if (shape === null) return null;
  if (shape.kind === "given") return shape.part;
  if (shape.kind === "sphere") {
    const { view, at, radius } = shape;
    return { kind: "sphere", surface: { view, at, frame_size: sizes.get(view) }, radius };
  }
  if (shape.kind === "scribble") return strokesToPart(shape.strokes, shape.thickness, sizes);
  const [first, ...others] = shape.prompts.filter((p) => !isEmpty(p)).map((p) => promptsToPart(p, sizes));
  if (first === undefined) return null;
  return { kind: "object", ...first, ...(others.length > 0 ? { other_views: others } : {}) };
}

/** The request for all objects together; null where none has anything. */
export function toRequest(items: Item[], sizes: Map<string, Size>, dilate: number): MaskRequest | null {
  const named = items.flatMap((item) => {
    const part = toPart(item.shape, sizes);
    return part === null ? [] : [[item.name, part] as const];
  });
  const [first] = named;
  if (first === undefined) return null;
  const mask = named.length === 1 ? first[1] : { kind: "objects", named: Object.fromEntries(named) };
  return { mask, dilate };
}

/** Objects of a request that was saved. */
export function fromRequest(request: MaskRequest, sizes: Map<string, Size>): Item[] {
  const named = request.mask.kind === "objects" ? Object.entries(request.mask.named as Record<string, Part>) : null;
  const parts = named ?? [["object-1", request.mask] as [string, Part]];
  return parts.map(([name, part], index) => ({ id: index + 1, name, shape: fromPart(part, sizes) }));
}

function promptsToPart(prompts: Prompts, sizes: Map<string, Size>): Record<string, unknown> {
  const { view, points, background, box } = prompts;
  return { view, frame_size: sizes.get(view), points, background, ...(box ? { box } : {}) };
}

function strokesToPart(strokes: Stroke[], thickness: number, sizes: Map<string, Size>): Part | null {
  const parts = strokes.map(({ view, path }) => ({
    kind: "scribble", view, frame_size: sizes.get(view), path, thickness,
  }));
  const [first] = parts;
  if (first === undefined) return null;
  return parts.length === 1 ? first : { kind: "union", of: parts };
}

function fromPart(part: Part, sizes: Map<string, Size>): Shape {
  if (part.kind === "object") {
    const all = [part, ...((part.other_views as Part[] | undefined) ?? [])];
    return { kind: "object", prompts: all.map((one) => promptsFromPart(one, sizes)) };
  }
  const parts = part.kind === "union" ? (part.of as Part[]) : [part];
  if (parts.every((one) => one.kind === "scribble" && (one.path as Pixel[]).length > 0)) {
    const strokes = parts.map((one) => {
      const view = one.view as string;
      return { view, path: (one.path as Pixel[]).map((xy) => rescale(xy, one, sizes.get(view))) };
    });
    return { kind: "scribble", strokes, thickness: parts[0]!.thickness as number };
  }
  if (part.kind === "sphere" && part.surface) {
    const click = part.surface as { view: string; at: Pixel };
    const at = rescale(click.at, click, sizes.get(click.view));
    return { kind: "sphere", view: click.view, at, radius: part.radius as number };
  }
  return { kind: "given", part };
}

function promptsFromPart(part: Record<string, unknown>, sizes: Map<string, Size>): Prompts {
  const view = part.view as string;
  const move = (xy: Pixel) => rescale(xy, part, sizes.get(view));
  const box = part.box as Box | null | undefined;
  return {
    view,
    points: (part.points as Pixel[]).map(move),
    background: (part.background as Pixel[]).map(move),
    box: box ? [...move([box[0], box[1]]), ...move([box[2], box[3]])] : null,
  };
}

/** A pixel read on a picture of another size, on the page's. */
function rescale([x, y]: Pixel, part: object, size: Size | undefined): Pixel {
  const from = (part as { frame_size?: Size | null }).frame_size;
  return from && size ? [(x * size[0]) / from[0], (y * size[1]) / from[1]] : [x, y];
}
