import { byId, element, setText } from "./dom.js";
import { texts } from "./texts.js";
/** Counters that are shown first, because each count may be felt or is a sign of a fault. */
const IMPORTANT = [
    "underruns",
    "late_blocks",
    "lost_samples",
    "late_contacts",
    "lost_contacts",
    "disconnects",
    "limited_samples",
];
/** Show how well the display is served, once a second. */
export function showHealth(session) {
    const first = new Figures(byId("health-figures"));
    const rest = new Figures(byId("health-rest"));
    session.changed.on(() => {
        const stats = session.latestStats;
        // Figures of a display that is not armed are those of when it last was.
        const playing = stats?.state === "armed" ? stats : undefined;
        first.set("link", texts.link, stats ? texts.linkState(stats.link) : texts.unknown);
        first.set("latency", texts.latency, texts.milliseconds(playing?.latency_ms ?? undefined));
        first.set("lead", texts.lead, texts.milliseconds(stats?.lead_ms ?? undefined));
        const roundTrip_ms = session.isConnected ? session.connection.roundTrip_ms : undefined;
        first.set("round-trip", texts.roundTrip, texts.milliseconds(roundTrip_ms));
        first.set("put-out", texts.putOut, texts.share(stats?.put_out_share));
        first.set("finger", texts.fingerLabel, owner(playing));
        showCounters(stats?.counters ?? {}, first, rest);
    });
}
function owner(stats) {
    if (!stats)
        return texts.unknown;
    if (!stats.touching)
        return texts.nobodyTouches;
    return stats.owner ? texts.thisPageTouches : texts.anotherTouches;
}
function showCounters(values, first, rest) {
    for (const [name, count] of Object.entries(values)) {
        const figures = IMPORTANT.includes(name) ? first : rest;
        figures.set(name, texts.counter(name), texts.count(count), count > 0);
    }
}
/** A list of names and values, whose elements are made once. */
class Figures {
    constructor(list) {
        this.list = list;
        this.values = new Map();
    }
    /** Show a value; a marked one stands out by its weight and color. */
    set(id, label, text, isMarked = false) {
        const value = this.values.get(id) ?? this.add(id, label);
        setText(value, text);
        value.classList.toggle("marked", isMarked);
    }
    add(id, label) {
        const value = element("dd");
        value.dataset.testid = id;
        const row = element("div");
        row.append(element("dt", label), value);
        this.list.append(row);
        this.values.set(id, value);
        return value;
    }
}
