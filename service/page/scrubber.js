// Controls that play a run, or move through its instants.

import { element, showText } from "./elements.js";

const PLAY_MS = 4000;
const STEPS = 6; // instants shown to users who prefer reduced motion

/**
 * Build the controls.
 *
 * @param {HTMLElement} root
 * @param {(row: number) => void} onMove called with the row of the history to show
 * @returns {{setTimes: (times: number[], row: number) => void, move: (row: number) => void, stop: () => void}}
 */
export function buildScrubber(root, onMove) {
  let times = [0];
  let frame;
  const button = element("button", { type: "button", onclick: () => (frame ? stop() : play()) }, "Play");
  const slider = element("input", { type: "range", min: 0, max: 0, step: 1, "aria-label": "Instant", oninput: scrub });
  const output = element("output.instant", {});
  root.append(button, slider, output);

  function show(row) {
    slider.value = row;
    const text = `${(times[row] * 1e3).toFixed(2)} ms`;
    slider.setAttribute("aria-valuetext", text);
    showText(output, text);
  }

  function move(row) {
    show(row);
    onMove(row);
  }

  function scrub() {
    stop();
    move(Number(slider.value));
  }

  function stop() {
    cancelAnimationFrame(frame);
    frame = undefined;
    button.textContent = "Play";
  }

  function play() {
    const isCalm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const last = times.length - 1;
    const from = Number(slider.value) < last ? Number(slider.value) / last : 0;
    const start = performance.now() - from * PLAY_MS;
    button.textContent = "Pause";
    const step = (now) => {
      const share = Math.min((now - start) / PLAY_MS, 1);
      const row = Math.round((isCalm ? Math.round(share * STEPS) / STEPS : share) * last);
      if (row !== Number(slider.value)) move(row);
      if (share < 1) frame = requestAnimationFrame(step);
      else stop();
    };
    frame = requestAnimationFrame(step);
  }

  return {
    move,
    stop,
    setTimes(next, row) {
      stop();
      times = next;
      slider.max = times.length - 1;
      show(row);
    },
  };
}
