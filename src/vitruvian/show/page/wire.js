// Decodes the messages of vitruvian.show.wire: magic VTF1, length, JSON header, 8-byte aligned blocks.

export const VERSION = 1;
const ARRAYS = {
  float32: Float32Array, uint32: Uint32Array, uint16: Uint16Array, int16: Int16Array, uint8: Uint8Array, int8: Int8Array,
};

/** {header, blocks}: blocks[actor][channel] = {array, shape, scale, origin}, views into the message. */
export function decode(buffer, start = 0, length = buffer.byteLength - start) {
  const view = new DataView(buffer, start, length);
  if (length < 8 || view.getUint32(0) !== 0x56544631) throw new Error("not a vitruvian message");
  const data = start + 8 + view.getUint32(4, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, start + 8, data - start - 8)));
  const blocks = {};
  for (const b of header.blocks) {
    const count = b.shape.reduce((a, n) => a * n, 1);
    (blocks[b.actor] ??= {})[b.channel] = {
      array: new ARRAYS[b.dtype](buffer, data + b.offset, count), shape: b.shape, scale: b.scale, origin: b.origin,
    };
  }
  return { header, blocks };
}

/** Messages of a recording: each prefixed by its length (uint32, then 4 bytes of padding), padded to 8. */
export function* messages(bytes) {
  const { buffer, byteOffset, byteLength } = bytes, view = new DataView(buffer, byteOffset, byteLength);
  for (let at = 0; at < byteLength;) {
    const length = view.getUint32(at, true);
    yield decode(buffer, byteOffset + at + 8, length);
    at += 8 + length + ((8 - (length % 8)) % 8);
  }
}

/** Quantised positions (int16 x 4) into float32 x 3. */
export function positions({ array, scale, origin }, out) {
  const h = scale / 32767;
  for (let i = 0, k = 0; k < array.length; i += 3, k += 4) {
    out[i] = origin[0] + array[k] * h; out[i + 1] = origin[1] + array[k + 1] * h; out[i + 2] = origin[2] + array[k + 2] * h;
  }
}

/** Quantised normals (int8 x 4) into float32 x 3. */
export function normals({ array }, out) {
  for (let i = 0, k = 0; k < array.length; i += 3, k += 4) {
    out[i] = array[k] / 127; out[i + 1] = array[k + 1] / 127; out[i + 2] = array[k + 2] / 127;
  }
}
