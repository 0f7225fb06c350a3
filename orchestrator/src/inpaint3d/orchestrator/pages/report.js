"use strict";
// Without this script the page shows before and after side by side, and the orbit's first view.
const $ = (selector) => document.querySelector(selector);

const compare = $(".compare");
if (compare) {
  const slider = compare.querySelector("input");
  const move = () => compare.style.setProperty("--at", slider.value + "%");
  slider.addEventListener("input", move);
  compare.classList.add("live");
  move();
}

const orbit = $(".orbit");
if (orbit) {
  const { names, before, after } = JSON.parse($("#orbit-frames").textContent);
  const [slider, button, name] = ["input", "button", "output"].map((tag) => orbit.querySelector(tag));
  const show = (index) => {
    slider.value = index;
    slider.setAttribute("aria-valuetext", names[index]);
    name.textContent = names[index];
    if (before.length) orbit.querySelector(".early").src = before[index];
    orbit.querySelector(".late").src = after[index];
  };
  let step = 1;
  let timer = null;
  // Back and forth: the first camera and the last are seldom neighbours.
  const turn = () => {
    const index = Number(slider.value);
    if (index + step < 0 || index + step >= names.length) step = -step;
    show(index + step);
  };
  const stop = () => {
    clearInterval(timer);
    timer = null;
    button.textContent = "Play";
  };
  const play = () => {
    timer = setInterval(turn, 160);
    button.textContent = "Pause";
  };
  button.addEventListener("click", () => (timer ? stop() : play()));
  slider.addEventListener("input", () => {
    stop();
    show(Number(slider.value));
  });
  addEventListener("beforeprint", stop);
  orbit.classList.add("live");
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) play();
}
