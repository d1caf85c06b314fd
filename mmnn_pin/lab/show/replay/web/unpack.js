/** The bytes of a compressed element of this page. */
async function unpack(id) {
  const text = atob(document.getElementById(id).textContent.trim());
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

/** Run the viewer's code; it leaves the global name MeshCat. */
async function loadViewer() {
  const script = document.createElement("script");
  script.textContent = new TextDecoder().decode(await unpack("viewer"));
  document.head.append(script);
}

/** The header of the data, with a typed array in the place of every reference to one. */
async function loadData() {
  const buffer = await unpack("data");
  const length = new DataView(buffer).getUint32(0, true);
  const types = { f4: Float32Array, u2: Uint16Array, u4: Uint32Array };
  const text = new TextDecoder().decode(new Uint8Array(buffer, 4, length));
  return JSON.parse(text, (key, value) =>
    value && value.type in types ? new types[value.type](buffer, 4 + length + value.at, value.size) : value);
}
