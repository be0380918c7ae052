// SVG elements.

const SVG = "http://www.w3.org/2000/svg";

export function node(tag, attributes = {}, content = "") {
  const made = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (content) made.textContent = content;
  return made;
}

export const line = (x1, y1, x2, y2, stroke, width = 1) => node("line", { x1, y1, x2, y2, stroke, "stroke-width": width });
export const text = (x, y, content, anchor) => node("text", { x, y, "text-anchor": anchor }, content);
