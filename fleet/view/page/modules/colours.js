// The hues of the plots, lighter, because the sea is dark here. States of links differ in width and dashes, too.
export const HULLS = ["#4fa8e0", "#ff8a3d", "#2fce9f", "#e09ac4", "#9adcff", "#f5c04a"];
export const SILENT = "#93a1b2";
// From so many vehicles on there is no room for packets, and for labels of a few only.
export const isCrowd = ({ vehicles }) => vehicles > 24;
export const hull = (i) => HULLS[(i - 1) % HULLS.length];

export const LINKS = {
  delivering: { name: "delivering", colour: "#7cc4f2", width: 1.6, dash: [], says: "everything arrives in time" },
  late: { name: "late", colour: "#ffe08a", width: 2, dash: [10, 3], says: "arrives after the next one was sent" },
  losing: { name: "losing", colour: "#ffa94d", width: 2.2, dash: [5, 4], says: "some of the last ten packets were lost" },
  cut: { name: "cut", colour: "#ff5c6c", width: 3, dash: [3, 4], says: "cut, or five packets in a row were lost" },
  stale: { name: "stale", colour: "#93a1b2", width: 2, dash: [2, 5], says: "nothing has arrived for long" },
  silent: { name: "silent", colour: "#4a5d73", width: 1, dash: [], says: "nothing was sent yet" },
};
export const PACKETS = { arrived: "#d6f0ff", late: "#ffe08a", damaged: "#e09ac4", lost: "#ffa94d", cut: "#ff5c6c" };
