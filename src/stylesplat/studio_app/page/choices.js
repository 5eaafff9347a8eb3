// What is chosen in this browser, and nowhere else

import { effect, signal } from "./libraries/signals.js";

// A choice that a reload of the page keeps, or that this browser always does
export function kept(name, value, storage = sessionStorage) {
  const choice = signal(JSON.parse(storage.getItem(name)) ?? value);
  effect(() => storage.setItem(name, JSON.stringify(choice.value)));
  return choice;
}

export const tool = signal("object"); // or surface, wand, color, ball, brush, lasso, rectangle, box, strokes, mask, mend, guide
export const active = signal(null); // the name of the layer whose controls are shown
export const above = signal(false); // whether the next style goes on a new layer
export const shows = signal(false); // whether the brush of a mask paints the layer in
export const soft = signal(0.5); // share of its radius over which that brush fades
export const how = signal("new"); // what a pick does to the one before: new, add, away or within
export const radius = signal(0); // of the ball, in world units
export const SIZES = ["part", "object", "group"];
export const size = signal("object"); // of what a click on the surface picks: or part, group
export const reach = signal(0); // of the wand, likewise
export const tolerance = signal(0.15); // of colours that are alike: how far red, green and blue differ
export const brush = signal(0.03); // its radius, as a share of the picture's height
export const guideReach = signal(0.1); // how far strokes follow a line, in extents of the object
export const mode = kept("mode", "after"); // or split, before
export const cut = kept("cut", 0.5); // where the border between before and after is, as a share
export const showPhotos = signal(false);
export const background = signal([0.086, 0.086, 0.094]);
export const settings = kept("settings", {}); // of paintings, where they are not the defaults
export const regions = kept("regions", {}); // the parts of style pictures to use, by title
export const presets = kept("presets", {}, localStorage); // settings that are kept in this browser, by name
export const dialog = signal(null); // keep, settings, part, view, help
export const variant = signal(null); // the id of the variant that is being named
export const part = signal(null); // the style picture whose part is being chosen
export const hint = kept("hint", 0, localStorage); // how many hints were seen
export const tab = signal("styles"); // on narrow screens
export const strip = signal("styles"); // at the bottom: or views
export const leveling = signal(false); // whether the horizon is being turned
export const turntable = signal({ seconds: 4, fps: 30, width: 960, around: "", path: "photos" });
