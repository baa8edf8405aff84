// Stroke over oak for two seconds, on the display of a running `tactile serve`:
//
//     node examples/quickstart.mjs [URL]
import { connect } from "tactile-client";

const webSocket = globalThis.WebSocket ?? (await import("ws")).default; // node < 22: npm install ws
const connection = connect({ url: process.argv[2] ?? "ws://127.0.0.1:7411/v1", webSocket });
await connection.ready();
const display = connection.display();
await display.select("wood-oak");

console.log(`High voltage on ${display.name} is switched on in 3 s; Ctrl+C prevents it.`);
await new Promise((resolve) => setTimeout(resolve, 3000));
await display.arm();

display.telemetry(5, ({ position_mm, drive_v }) => {
  const drive = Math.max(...drive_v.map(Math.abs));
  console.log(`finger at ${position_mm[0].toFixed(1)} mm, drive ${drive.toFixed(1)} V`);
});
const begun = performance.now();
for (let t = 0; t < 2; t = (performance.now() - begun) / 1000) {
  display.touch([20 * Math.sin(Math.PI * t), 0], { normal_force_n: 0.5 });
  await new Promise((resolve) => setTimeout(resolve, 10));
}
display.lift();
await display.disarm();
connection.close();
