// What the page asks the server. Its own address holds the token: all paths are relative to it.

import type { MaskRequest, Size } from "./requests";

export type Outline = number[][];

export interface Scene {
  title: string;
  frames: { name: string; size: Size }[];
  missing: string | null;
  finder: string;
  saved: MaskRequest | null;
  problem: string | null;
  file: string;
  then: string;
  painted: Painted | null;
}
export interface Painted {
  views: Record<string, boolean>;
  file: string;
  then: string;
}
export interface Progress {
  number: number;
  revision: number;
  done: number;
  total: number;
  complete: boolean;
  error: string | null;
  seconds: number;
  consistency: number | null;
  outlines: Record<string, Outline> | null;
  shares: Record<string, number> | null;
  to_check: string[];
}

export const askScene = () => ask<Scene>("scene");
export const askMask = (request: MaskRequest, view: string) =>
  ask<{ outline: Outline | null; share: number | null }>("mask", { request, view });
export const askToCarry = (request: MaskRequest) => ask<{ number: number }>("carry", { request });
export const askProgress = (revision: number) => ask<Progress>("progress", { revision });
export const save = (request: MaskRequest) => ask<{ file: string; then: string }>("save", { request });
export const forget = (view: string) => ask<Painted>("forget", { view });
export const putPainted = (file: File) => {
  const type = file.type || (/\.tiff?$/i.test(file.name) ? "image/tiff" : "application/octet-stream");
  const sent = { method: "PUT", headers: { "Content-Type": type }, body: file };
  return fetchJson<Painted>(`painted/${encodeURIComponent(file.name)}`, sent);
};

export const givenOut = (part: string, name: string) => `painted/${part}/${encodeURIComponent(name)}.png`;
export const pictureOf = (name: string) => `frames/${encodeURIComponent(name)}.jpg`;
export const thumbnailOf = (name: string) => `thumbnails/${encodeURIComponent(name)}.jpg`;

function ask<T>(path: string, question?: unknown): Promise<T> {
  const headers = { "Content-Type": "application/json" };
  return fetchJson<T>(path, question === undefined ? {} : { method: "POST", headers, body: JSON.stringify(question) });
}

async function fetchJson<T>(path: string, sent: RequestInit): Promise<T> {
  let response: Response;
  try {
    response = await fetch(path, sent);
  } catch {
    throw new Error("The server does not answer: start `inpaint3d masks edit` again and open its address.");
  }
  const value = await response.json();
  if (!response.ok) throw new Error(value.error);
  return value;
}
