import { connect, RequestError } from "../client/index.js";
import type { Connection, Display, StatsReply, TelemetryMessage } from "../client/index.js";
import type { EventMessage, Failure } from "../client/index.js";
import { Signal } from "./signal.js";

/** State of the display as shown; "offline" as long as the server does not report one. */
export type ShownState = "disarmed" | "armed" | "estopped" | "lost" | "offline";

/** Telemetry per second during a stroke or while it is listened to, and otherwise. */
const [OFTEN_HZ, SELDOM_HZ] = [60, 20];
const STATS_EVERY_MS = 1000;
const STATES: readonly string[] = ["disarmed", "armed", "estopped", "lost"];

/** The connection to the server, the display that is shown, and what is known of it. */
export class Session {
  /** Emitted when the connection, the display or its state has changed. */
  readonly changed = new Signal<Session>();
  /** Emitted when another display is shown, or a display for the first time. */
  readonly displayChanged = new Signal<Session>();
  /** Emitted when a new connection was begun, with another token. */
  readonly reopened = new Signal<Session>();
  readonly telemetry = new Signal<TelemetryMessage>();
  readonly stats = new Signal<StatsReply>();
  readonly event = new Signal<EventMessage>();
  readonly failure = new Signal<Failure>();

  connection!: Connection;
  /** Whether an attempt to connect has failed, or the connection was lost. */
  hasFailed = false;
  display: Display | undefined;
  latestStats: StatsReply | undefined;
  /** Whether the server does not know the display any more. */
  displayIsGone = false;
  private reported: ShownState = "offline";
  private asking = false;
  private unsubscribe = () => {};
  private readonly hurried = new Set<string>();
  private readonly listener = (telemetry: TelemetryMessage) => this.takeTelemetry(telemetry);

  constructor() {
    this.open("");
    setInterval(() => void this.askStats(), STATS_EVERY_MS);
  }

  /** Begin a new connection, with a token if there is one. */
  open(token: string): void {
    const before = this.connection;
    const connection = connect({ client: "web page", ...(token && { token }) });
    this.connection = connection;
    this.showDisplay(undefined);
    before?.close();
    this.hasFailed = false;
    connection.on("state", () => {
      if (this.connection !== connection) return; // it was replaced, and is closed
      this.hasFailed ||= !this.isConnected;
      this.follow();
    });
    connection.on("event", (event) => this.takeEvent(event));
    connection.on("failure", (failure) => this.failure.emit(failure));
    this.reopened.emit(this);
    this.follow();
  }

  /** State of the display. */
  get state(): ShownState {
    return this.isConnected && this.display && !this.displayIsGone ? this.reported : "offline";
  }

  /** Whether the server has admitted this page. */
  get isConnected(): boolean {
    return this.connection.state === "connected";
  }

  /** Return whether the server lets this page do what a role allows. */
  may(role: "play" | "arm" | "stop"): boolean {
    return this.connection.welcome?.roles?.includes(role) ?? false;
  }

  /** Show another display. */
  show(name: string): void {
    this.showDisplay(this.connection.display(name));
    this.changed.emit(this);
  }

  /** Get telemetry often as long as something wants it: many pages may only watch. */
  hurry(what: string, isWanted: boolean): void {
    if (this.hurried.has(what) === isWanted) return;
    if (isWanted) this.hurried.add(what);
    else this.hurried.delete(what);
    this.subscribe();
  }

  /** Whether something wants telemetry often. */
  get isHurried(): boolean {
    return this.hurried.size > 0;
  }

  /** Ask for the state of the display now, for example after an event. */
  async askStats(): Promise<void> {
    const { display } = this;
    if (!this.isConnected || display === undefined || this.asking) return;
    this.asking = true;
    try {
      const stats = await display.stats();
      if (display === this.display) this.takeStats(stats);
    } catch (error) {
      if (display !== this.display) return;
      this.displayIsGone = error instanceof RequestError && error.code === "unknown_display";
      this.changed.emit(this);
    } finally {
      this.asking = false;
    }
  }

  private follow(): void {
    if (!this.isConnected) {
      this.reported = "offline";
      this.latestStats = undefined;
    } else {
      const names = this.connection.displays.map(({ name }) => name);
      const [first] = names;
      if (this.display === undefined && first !== undefined) this.show(first);
      this.displayIsGone = this.display !== undefined && !names.includes(this.display.name);
      void this.askStats();
    }
    this.changed.emit(this);
  }

  private showDisplay(display: Display | undefined): void {
    if (display === this.display && display !== undefined) return;
    this.unsubscribe();
    this.display = display;
    this.latestStats = undefined;
    this.reported = "offline";
    this.subscribe();
    this.displayChanged.emit(this);
    void this.askStats();
  }

  private subscribe(): void {
    const rate_hz = this.isHurried ? OFTEN_HZ : SELDOM_HZ;
    this.unsubscribe = this.display?.telemetry(rate_hz, this.listener) ?? (() => {});
  }

  private takeEvent(event: EventMessage): void {
    this.event.emit(event);
    void this.askStats();
  }

  private takeStats(stats: StatsReply): void {
    this.displayIsGone = false;
    this.latestStats = stats;
    this.report(stats.state);
    this.stats.emit(stats);
    this.changed.emit(this);
  }

  private takeTelemetry(telemetry: TelemetryMessage): void {
    this.telemetry.emit(telemetry);
    if (telemetry.state === this.reported) return;
    this.report(telemetry.state);
    this.changed.emit(this);
  }

  private report(state: string): void {
    // A later server may know other states. Such a display is not taken for harmless.
    this.reported = STATES.includes(state) ? (state as ShownState) : "lost";
  }
}
