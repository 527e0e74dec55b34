// node read_mcap.mjs PACKAGES FILE...: what @mcap/core, the reader inside Foxglove, finds in MCAP files, as JSON on
// stdout: one object a file under "files", and the schemas that Foxglove publishes under "published".
// PACKAGES is the folder into which npm installed @mcap/core, @mcap/support (decodes protobuf by the types in a file),
// fzstd (chunks are compressed), @foxglove/schemas, and the parser and reader of ROS messages.

import { createHash } from "node:crypto";
import { open } from "node:fs/promises";
import { createRequire } from "node:module";
import { join, resolve } from "node:path";

const [packages, ...paths] = process.argv.slice(2);
const require = createRequire(join(resolve(packages), "none.js"));
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { decompress } = require("fzstd");
const { protobufFromBinaryDescriptor } = require("@mcap/support");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");
const published = require("@foxglove/schemas/jsonschema");

const decompressHandlers = { zstd: (data, size) => decompress(data, new Uint8Array(Number(size))) };
// Foxglove shows a field that is not sent with its default, too.
const plain = { defaults: true, longs: Number, bytes: String, enums: Number };

/** Return a function that decodes messages of a type by the definition in the file. */
function decoder({ name, encoding, data }) {
  if (encoding === "ros2msg") {
    const reader = new MessageReader(parse(new TextDecoder().decode(data), { ros2: true }));
    return (bytes) => [...reader.readMessage(bytes).data];
  }
  const type = protobufFromBinaryDescriptor(data).lookupType(name);
  return (bytes) => type.toObject(type.decode(bytes), plain);
}

/** Return everything in a file, found by its index as Foxglove does. */
async function indexed(handle) {
  const readable = {
    size: async () => BigInt((await handle.stat()).size),
    read: async (offset, size) => {
      const bytes = new Uint8Array(Number(size));
      await handle.read(bytes, 0, Number(size), Number(offset));
      return bytes;
    },
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const channels = {};
  const decoders = new Map();
  for (const { id, topic, messageEncoding, schemaId, metadata } of reader.channelsById.values()) {
    const schema = reader.schemasById.get(schemaId);
    decoders.set(id, decoder(schema));
    const remarks = Object.fromEntries(metadata);
    channels[topic] = { messageEncoding, schema: schema.name, encoding: schema.encoding, remarks, messages: [] };
  }
  for await (const { channelId, logTime, publishTime, data } of reader.readMessages({ validateCrcs: true })) {
    const { topic } = reader.channelsById.get(channelId);
    channels[topic].messages.push([String(logTime), String(publishTime), decoders.get(channelId)(data)]);
  }
  const attachments = {};
  for await (const { name, mediaType, data } of reader.readAttachments({ validateCrcs: true })) {
    attachments[name] = [mediaType, createHash("sha256").update(data).digest("hex")];
  }
  const metadata = {};
  for await (const record of reader.readMetadata()) {
    metadata[record.name] = Object.fromEntries(record.metadata);
  }
  const { profile, library } = reader.header;
  return { profile, library, channels, attachments, metadata };
}

/** Return how many messages there are from the first byte to the last, all checksums compared. */
async function streamed(handle) {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  reader.append(await handle.readFile());
  let messages = 0;
  for (let record; (record = reader.nextRecord()); ) {
    messages += record.type === "Message" ? 1 : 0;
  }
  return { messages, done: reader.done() };
}

const files = [];
for (const path of paths) {
  const handle = await open(path);
  files.push({ ...(await indexed(handle)), streamed: await streamed(handle) });
  await handle.close();
}
console.log(JSON.stringify({ files, published }));
