// The theme of the page, which comes with the setup: the same words have other colours in the movie and in the log.
export let LINKS = {}; // by state: colour, width, dash, and what it means
let theme = { vehicles: ["#ffffff"], colours: {} };

export function useTheme(setup) {
  ({ theme } = setup);
  LINKS = Object.fromEntries(Object.entries(theme.links).map(([state, stroke]) => [state, { ...stroke, says: setup.link_meanings[state] }]));
}

export const hull = (i) => theme.vehicles[(i - 1) % theme.vehicles.length];
export const hulls = () => theme.vehicles.length;

// The colour of a word, such as `obstacle`, `packet lost` or `vehicle 3`.
export const colour = (word) => (word.startsWith("vehicle ") ? hull(Number(word.slice(8))) : theme.colours[word]);

// The same, through which one sees.
export function glass(word, alpha) {
  const [r, g, b] = [1, 3, 5].map((k) => parseInt(colour(word).slice(k, k + 2), 16));
  return `rgba(${r}, ${g}, ${b}, ${alpha})`;
}
