"use strict";
// A page of something that goes on looks again by itself; what a person has opened or is at stays as it is.
const INTERVAL_MS = 2000;

const look = async () => {
  if (document.hidden) return;
  const answer = await fetch(location.href).catch(() => null);
  if (!answer || !answer.ok) return;
  const fresh = new DOMParser().parseFromString(await answer.text(), "text/html");
  for (const part of document.querySelectorAll("[data-live]")) {
    const next = fresh.querySelector(`[data-live="${part.dataset.live}"]`);
    if (next && next.innerHTML !== part.innerHTML && !part.contains(document.activeElement)) part.innerHTML = next.innerHTML;
  }
};

if (document.querySelector("[data-live]")) setInterval(look, INTERVAL_MS);
