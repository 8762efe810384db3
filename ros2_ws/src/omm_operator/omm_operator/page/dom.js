// Elements from descriptions, brought up to date in place: focus, scrolling and a pressed button stay.

const SVG = "http://www.w3.org/2000/svg";

export function h(tag, props, ...children) {
  return { tag, props: props || {}, children: children.flat(3).filter((c) => c !== null && c !== undefined && c !== false) };
}

export function patch(parent, children) {
  const svg = parent.namespaceURI === SVG;
  children.forEach((wanted, at) => {
    const there = parent.childNodes[at];
    const made = fitting(there, wanted) ? there : make(wanted, svg);
    if (made !== there) {
      if (there) parent.replaceChild(made, there);
      else parent.appendChild(made);
    }
    update(made, wanted);
  });
  while (parent.childNodes.length > children.length) parent.removeChild(parent.lastChild);
}

function fitting(node, wanted) {
  if (!node) return false;
  if (typeof wanted !== "object") return node.nodeType === Node.TEXT_NODE;
  return node.nodeType === Node.ELEMENT_NODE && node.localName === wanted.tag && (node.ommKey || null) === (wanted.props.key || null);
}

function make(wanted, svg) {
  if (typeof wanted !== "object") return document.createTextNode(String(wanted));
  return svg || wanted.tag === "svg" ? document.createElementNS(SVG, wanted.tag) : document.createElement(wanted.tag);
}

function update(node, wanted) {
  if (typeof wanted !== "object") {
    if (node.data !== String(wanted)) node.data = String(wanted);
    return;
  }
  const before = node.ommProps || {};
  for (const name of Object.keys(before)) if (!(name in wanted.props)) set(node, name, undefined);
  for (const [name, value] of Object.entries(wanted.props)) if (before[name] !== value) set(node, name, value);
  node.ommProps = wanted.props;
  node.ommKey = wanted.props.key;
  if (!wanted.props.own) patch(node, wanted.children);
}

function set(node, name, value) {
  if (name === "key" || name === "own") return;
  if (name.startsWith("on")) node[name] = value || null;
  else if (name === "value" || name === "checked") node[name] = value;
  else if (value === undefined || value === null || value === false) node.removeAttribute(name);
  else node.setAttribute(name, value === true ? "" : value);
}
