// Asks for masks as objects change: at once on the view that is looked at, then carried to all. The latest wins.

import { toPart, viewsOf, type Item, type MaskRequest, type Size } from "./requests";
import { askMask, askProgress, askToCarry, type Outline, type Progress } from "./server";

const PAUSE_MS = 250; // without a change before masks are carried
const POLL_MS = 200;

/** What is known of an object's masks, by view. `of`: the request that they are of; what is older is shown as such. */
interface Masks {
  of: string;
  outlines: Record<string, Outline>;
  shares: Record<string, number>;
  complete: boolean;
  doubtful: string[];
}
const NOTHING: Masks = { of: "", outlines: {}, shares: {}, complete: false, doubtful: [] };

export interface Told {
  status: (text: string) => void;
  error: (text: string) => void;
  changed: () => void;
}

export class Masking {
  private readonly known = new Map<number, Masks>();
  private items: Item[] = [];
  private dilate = 0;
  private wanted: (() => Promise<void>) | null = null;
  private asking = false;
  private waiting: Item[] = [];
  private carrying: Item | null = null;
  private revision = 0;
  private timer = 0;

  constructor(
    private readonly sizes: Map<string, Size>,
    private readonly canCarry: boolean,
    private readonly told: Told,
  ) {}

  outline(item: Item, view: string): Outline {
    return this.known.get(item.id)?.outlines[view] ?? [];
  }
  share(item: Item, view: string): number | null {
    return this.known.get(item.id)?.shares[view] ?? null;
  }
  /** Whether what is shown of an object is of an older request. */
  isStale(item: Item): boolean {
    return this.masksOf(item).of !== this.keyOf(item);
  }

  /** Whether some object's mask on a view agrees little with its neighbours'. */
  isDoubtful(view: string): boolean {
    return [...this.known.values()].some((masks) => masks.doubtful.includes(view));
  }

  /** Look at all objects again: those that changed are asked for, the active one first. */
  update(items: Item[], active: Item, view: string, dilate: number): void {
    [this.items, this.dilate] = [items, dilate];
    for (const id of this.known.keys()) {
      const item = items.find((one) => one.id === id);
      if (item === undefined || toPart(item.shape, this.sizes) === null) this.known.delete(id);
    }
    const changed = items.filter((item) => this.isWanting(item));
    changed.sort((a, b) => Number(b.id === active.id) - Number(a.id === active.id));
    this.askAtOnce(changed.find((item) => this.isStale(item)) ?? active, view);
    if (!this.canCarry) return;
    this.waiting = changed;
    clearTimeout(this.timer);
    if (changed.length > 0) this.timer = window.setTimeout(() => void this.carryNext(), PAUSE_MS);
  }

  private masksOf(item: Item): Masks {
    return this.known.get(item.id) ?? NOTHING;
  }
  private keyOf(item: Item): string {
    return JSON.stringify([toPart(item.shape, this.sizes), this.dilate]);
  }
  private isCurrent(item: Item, key: string): boolean {
    const now = this.items.find((one) => one.id === item.id);
    return now !== undefined && this.keyOf(now) === key;
  }
  private isWanting(item: Item): boolean {
    if (toPart(item.shape, this.sizes) === null) return false;
    const key = this.keyOf(item);
    if (this.carrying?.id === item.id && this.keyOf(this.carrying) === key) return false;
    return this.isStale(item) || !this.masksOf(item).complete;
  }

  /** The mask on the view that is looked at; where nothing can be carried, on each view that was pointed at. */
  private askAtOnce(item: Item, view: string): void {
    const mask = toPart(item.shape, this.sizes);
    if (mask === null) return;
    const views = this.canCarry ? [view] : [view, ...viewsOf(item.shape).filter((name) => name !== view)];
    const missing = views.filter((name) => this.isStale(item) || this.masksOf(item).outlines[name] === undefined);
    const request: MaskRequest = { mask, dilate: this.dilate };
    const key = this.keyOf(item);
    if (missing.length === 0) return;
    this.wanted = async () => {
      for (const name of missing) await this.askOn(item, key, request, name);
    };
    void this.work();
  }

  private async askOn(item: Item, key: string, request: MaskRequest, view: string): Promise<void> {
    const began = performance.now();
    const { outline, share } = await askMask(request, view);
    if (outline === null || share === null || !this.isCurrent(item, key)) return;
    const before = this.masksOf(item);
    if (before.of === key && before.complete && this.canCarry) return;
    const kept = this.canCarry || before.of === key ? before : NOTHING;
    this.known.set(item.id, {
      of: this.canCarry ? before.of : key,
      outlines: { ...kept.outlines, [view]: outline },
      shares: { ...kept.shares, [view]: share },
      complete: !this.canCarry,
      doubtful: [],
    });
    this.told.error("");
    this.told.status(`${item.name}: ${percent(share)} of this view, found in ${seconds(performance.now() - began)}`);
    this.told.changed();
  }

  /** One question at a time; of those that come meanwhile, the last. */
  private async work(): Promise<void> {
    if (this.asking) return;
    this.asking = true;
    while (this.wanted !== null) {
      const next = this.wanted;
      this.wanted = null;
      try {
        await next();
      } catch (error) {
        this.told.error((error as Error).message);
      }
    }
    this.asking = false;
  }

  private async carryNext(): Promise<void> {
    const item = this.waiting.shift();
    if (item === undefined) return;
    const before = this.carrying;
    if (before !== null && before.id !== item.id) this.waiting.push(before); // it comes again, from the start
    this.carrying = item;
    try {
      await askToCarry({ mask: toPart(item.shape, this.sizes)!, dilate: this.dilate });
      if (before === null) await this.follow();
    } catch (error) {
      this.carrying = null;
      this.told.error((error as Error).message);
    }
  }

  /** Until what is carried is complete, whichever object it is by then. */
  private async follow(): Promise<void> {
    while (this.carrying !== null) {
      const item = this.carrying;
      const progress = await askProgress(this.revision);
      if (item !== this.carrying) continue;
      this.revision = progress.revision;
      this.take(item, progress);
      if (progress.complete) {
        this.carrying = null;
        void this.carryNext();
      } else {
        await new Promise((resolve) => setTimeout(resolve, POLL_MS));
      }
    }
  }

  private take(item: Item, progress: Progress): void {
    const of = this.keyOf(item);
    const before = this.masksOf(item);
    if (progress.error !== null) {
      this.told.error(progress.error);
      this.known.set(item.id, { ...before, of, complete: true });
    } else if (progress.outlines !== null && progress.shares !== null) {
      this.known.set(item.id, {
        of,
        outlines: { ...before.outlines, ...progress.outlines },
        shares: { ...before.shares, ...progress.shares },
        complete: progress.complete,
        doubtful: progress.to_check,
      });
      this.told.error("");
    } else if (progress.complete) {
      this.known.set(item.id, { ...before, complete: true });
    }
    this.told.status(describe(item, progress));
    this.told.changed();
  }
}

function describe(item: Item, progress: Progress): string {
  if (progress.error !== null) return `${item.name}: not carried`;
  if (!progress.complete) {
    const how = progress.total > 0 ? `${progress.done} of ${progress.total} views` : "begun";
    return `${item.name}: carrying to other views, ${how}`;
  }
  const { consistency } = progress;
  const agreement = consistency === null ? "" : `; neighbouring views agree by ${percent(consistency)}`;
  const doubts = progress.to_check.length === 0 ? "" : `; ${progress.to_check.length} of them are to be looked at`;
  return `${item.name}: carried to all views in ${seconds(1000 * progress.seconds)}${agreement}${doubts}`;
}

export const percent = (share: number) => `${(100 * share).toFixed(1)} %`;
const seconds = (milliseconds: number) => `${(milliseconds / 1000).toFixed(1)} s`;
