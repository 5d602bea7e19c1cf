// The colour map for speeds: viridis, whose brightness increases evenly.

const STOPS = "#440154 #482878 #3e4989 #31688e #26828e #1f9e89 #35b779 #6ece58 #b5de2b #fde725".split(" ");

/** The colour map in Plotly's format: positions from 0 to 1, each with its colour. */
export const VIRIDIS = STOPS.map((colour, i) => [i / (STOPS.length - 1), colour]);

/** Return the CSS colour of a value in a range. */
export function viridis(value, [least, most], opacity) {
  const place = most > least ? ((value - least) / (most - least)) * (STOPS.length - 1) : STOPS.length - 1;
  const below = Math.min(Math.max(Math.floor(place), 0), STOPS.length - 2);
  const part = Math.min(Math.max(place - below, 0), 1);
  const channel = (stop, i) => Number.parseInt(STOPS[stop].slice(1 + 2 * i, 3 + 2 * i), 16);
  const mixed = [0, 1, 2].map((i) => Math.round(channel(below, i) * (1 - part) + channel(below + 1, i) * part));
  return `rgba(${mixed.join(",")},${opacity})`;
}
