// Reads logs with @mcap/core, the reader that Foxglove and Lichtblick use: by index and as a stream, every message
// decoded by the schema that the file carries. Exit status 1 and a sentence if anything is not as it should be.
//
//   cd .ci/mcap-core && npm install && node check.mjs ../../runs/latest/run.mcap ...

import { open, readFile } from "node:fs/promises";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";
import protobuf from "protobufjs";
import descriptor from "protobufjs/ext/descriptor/index.js";

const decompressHandlers = await loadDecompressHandlers();

/** Decoders by schema id; a 64-bit time becomes a number. */
function decoder(schema) {
  const root = protobuf.Root.fromDescriptor(descriptor.FileDescriptorSet.decode(schema.data));
  const type = root.lookupType(`.${schema.name}`);
  return (data) => type.toObject(type.decode(data), { longs: Number, defaults: true });
}

async function check(path) {
  const file = await open(path, "r");
  try {
    const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(file), decompressHandlers });
    const decoders = new Map([...reader.schemasById].map(([id, schema]) => [id, decoder(schema)]));
    const counts = new Map();
    const frames = new Set(["map"]); // to which the transforms lead
    let last = 0n;
    let messages = 0;
    for await (const message of reader.readMessages({ validateCrcs: true })) {
      const channel = reader.channelsById.get(message.channelId);
      const decoded = decoders.get(channel.schemaId)(message.data);
      if (message.logTime < last) throw new Error(`log time goes back at ${message.logTime} ns`);
      last = message.logTime;
      if (/\/state$/.test(channel.topic) && !Number.isFinite(decoded.x)) throw new Error(`${channel.topic}: no x`);
      if (/\/pose$/.test(channel.topic) && decoded.frame_id !== "ned") throw new Error(`${channel.topic}: no frame`);
      for (const { parent_frame_id: parent, child_frame_id: child } of decoded.transforms ?? []) {
        if (!frames.has(parent)) throw new Error(`${channel.topic}: ${child} hangs on ${parent}, which hangs on nothing`);
        frames.add(child);
      }
      for (const { id, frame_id: frame } of decoded.entities ?? []) {
        if (!frames.has(frame)) throw new Error(`${channel.topic}: ${id} is in ${frame}, which no transform leads to`);
      }
      const units = JSON.parse(channel.metadata.get("units"));
      if (messages < 1000 && Object.keys(units).length === 0) throw new Error(`${channel.topic}: no units`);
      counts.set(channel.topic, (counts.get(channel.topic) ?? 0) + 1);
      messages += 1;
    }
    if (BigInt(messages) !== reader.statistics.messageCount) throw new Error("the statistics count differently");
    let attachments = 0;
    for await (const attachment of reader.readAttachments()) {
      attachments += attachment.name === "scenario.yaml" ? 1 : 0;
    }
    let runs = 0;
    for await (const metadata of reader.readMetadata()) runs += metadata.name === "run" ? 1 : 0;
    if (attachments !== 1 || runs !== 1) throw new Error("scenario.yaml or the run's metadata is missing");

    const stream = new McapStreamReader({ decompressHandlers, validateCrcs: true });
    stream.append(await readFile(path));
    let streamed = 0;
    for (let record; (record = stream.nextRecord()); ) streamed += record.type === "Message" ? 1 : 0;
    if (!stream.done() || streamed !== messages) throw new Error(`as a stream it holds ${streamed} messages`);
    console.log(`${path}: ${messages} messages in ${counts.size} topics, decoded; ${Number(last) / 1e9} s`);
  } finally {
    await file.close();
  }
}

let failed = process.argv.length < 3;
if (failed) console.error("usage: node check.mjs LOG...");
for (const path of process.argv.slice(2)) {
  try {
    await check(path);
  } catch (error) {
    console.error(`${path}: ${error.message}`);
    failed = true;
  }
}
process.exit(failed ? 1 : 0);
