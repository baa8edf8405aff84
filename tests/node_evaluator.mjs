// Evaluates lines of standard input, each the JSON text of JavaScript with the client's names and the
// object `kept` in scope, and prints what each comes to as a line of JSON.
import { createRequire } from "node:module";
import { createInterface } from "node:readline";

const [folder] = process.argv.slice(2);
const client = await import(`${folder}/client/index.js`);
// node has a WebSocket since version 22; Debian keeps that of ws here
const WebSocket = globalThis.WebSocket ?? createRequire(import.meta.url)("/usr/share/nodejs/ws");
const AsyncFunction = (async () => {}).constructor;
const scope = { ...client, WebSocket, kept: {} };

for await (const line of createInterface({ input: process.stdin })) {
  let outcome;
  try {
    const evaluate = new AsyncFunction(...Object.keys(scope), JSON.parse(line));
    outcome = { value: (await evaluate(...Object.values(scope))) ?? null };
  } catch (error) {
    outcome = { error: error.name, message: error.message, code: error.code ?? "" };
  }
  process.stdout.write(`${JSON.stringify(outcome)}\n`);
}
process.exit();
