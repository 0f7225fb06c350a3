// What a person has pointed at, and the mask request (schemas/artifacts/mask-request) that says the same.

export type Pixel = [number, number];
export type Box = [number, number, number, number];
export type Size = [number, number];
export type Vector = [number, number, number];

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
  | Sphere;
export interface Sphere {
  kind: "sphere";
  centre: Vector;
  radius: number;
  depth: number; // of the surface clicked at; the radius is shown as a share of it
}

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
const NEW_RADIUS = 0.12; // of the depth at the click

export function isEmpty(prompts: Prompts): boolean {
  return prompts.points.length === 0 && prompts.box === null;
}

/** The views that were pointed at. */
export function viewsOf(shape: Shape | null): string[] {
  if (shape?.kind === "object") return shape.prompts.map((prompts) => prompts.view);
  return shape?.kind === "scribble" ? [...new Set(shape.strokes.map((stroke) => stroke.view))] : [];
}

/** An object's part of the request; null while there is too little to ask for. */
export function toPart(shape: Shape | null, sizes: Map<string, Size>): Part | null {
  if (shape === null) return null;
  if (shape.kind === "sphere") return { kind: "sphere", centre: shape.centre, radius: shape.radius };
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

/** Objects of a request that was saved; null where it holds what this page does not show. */
export function fromRequest(request: MaskRequest, sizes: Map<string, Size>): Item[] | null {
  const named = request.mask.kind === "objects" ? Object.entries(request.mask.named as Record<string, Part>) : null;
  const parts = named ?? [["object-1", request.mask] as [string, Part]];
  const items = parts.map(([name, part], index) => ({ id: index + 1, name, shape: fromPart(part, sizes) }));
  return items.every((item) => item.shape !== null) ? items : null;
}

export function sphereAt(centre: Vector, depth: number): Sphere {
  return { kind: "sphere", centre, radius: NEW_RADIUS * depth, depth };
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

function fromPart(part: Part, sizes: Map<string, Size>): Shape | null {
  if (part.kind === "object") {
    const all = [part, ...((part.other_views as Part[] | undefined) ?? [])];
    return { kind: "object", prompts: all.map((one) => promptsFromPart(one, sizes)) };
  }
  if (part.kind === "scribble" || part.kind === "union") {
    const parts = part.kind === "union" ? (part.of as Part[]) : [part];
    if (parts.some((one) => one.kind !== "scribble" || (one.path as Pixel[]).length === 0)) return null;
    const strokes = parts.map((one) => {
      const view = one.view as string;
      return { view, path: (one.path as Pixel[]).map((xy) => rescale(xy, one, sizes.get(view))) };
    });
    return { kind: "scribble", strokes, thickness: parts[0]?.thickness as number };
  }
  if (part.kind === "sphere" && Array.isArray(part.centre)) {
    const radius = part.radius as number;
    return { kind: "sphere", centre: part.centre as Vector, radius, depth: radius / NEW_RADIUS };
  }
  return null;
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
function rescale([x, y]: Pixel, part: Record<string, unknown>, size: Size | undefined): Pixel {
  const from = part.frame_size as Size | null | undefined;
  return from && size ? [(x * size[0]) / from[0], (y * size[1]) / from[1]] : [x, y];
}
