// Views that a person paints in: given out as pictures, dropped here again.

import { byId, html, replaceChildren } from "./elements";
import { forget, givenOut, putPainted, type Painted } from "./server";

/** The list of them with what can be done; `taken` hears of every picture that was kept, `say` of what was refused. */
export function listPainted(painted: Painted, taken: (painted: Painted) => void, say: (error: string) => void): void {
  const zone = byId("painting");
  const draw = (now: Painted) => {
    const rows = Object.entries(now.views).map(([name, done]) => describe(name, done, act));
    replaceChildren(byId("asked"), ...rows);
  };
  const act = async (what: () => Promise<Painted>, keep: boolean) => {
    try {
      const now = await what();
      say("");
      draw(now);
      if (keep) taken(now);
    } catch (error) {
      say((error as Error).message);
    }
  };
  const put = async (files: Iterable<File>) => {
    for (const file of files) await act(() => putPainted(file), true);
  };
  const choose = byId<HTMLInputElement>("paintings");
  choose.addEventListener("change", () => void put([...(choose.files ?? [])]).then(() => (choose.value = "")));
  zone.addEventListener("dragover", (event) => {
    event.preventDefault();
    zone.classList.add("over");
  });
  zone.addEventListener("dragleave", () => zone.classList.remove("over"));
  zone.addEventListener("drop", (event) => {
    event.preventDefault();
    zone.classList.remove("over");
    void put([...(event.dataTransfer?.files ?? [])]);
  });
  zone.hidden = false;
  draw(painted);
}

type Act = (what: () => Promise<Painted>, keep: boolean) => void;

function describe(name: string, done: boolean, act: Act): HTMLElement {
  const link = (part: string, text: string) =>
    html("a", { href: givenOut(part, name), download: part === "asked" ? `${name}.png` : `${name}.${part}.png` }, text);
  const row = html("span", { class: "row" }, link("asked", `Picture of ${name}`), link("masks", `Mask of ${name}`));
  if (done) {
    const remove = html("button", { type: "button", "data-key": `forget ${name}` }, `Remove ${name}`);
    remove.addEventListener("click", () => act(() => forget(name), false));
    row.append(remove);
  }
  return html("li", {}, html("span", {}, `${name}: ${done ? "painted" : "not painted"}`), row);
}
