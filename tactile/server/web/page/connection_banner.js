import { byId, showText } from "./dom.js";
import { texts } from "./texts.js";
/** Show in a sentence why there is no connection, or what is wrong with the display. */
export function showConnectionBanner(session) {
    const banner = byId("banner");
    let wasConnected = false;
    const show = () => {
        wasConnected ||= session.isConnected;
        showText(banner, sentence(session, wasConnected));
    };
    session.changed.on(show);
    show();
}
function sentence(session, wasConnected) {
    const { state, reason } = session.connection;
    if (state === "refused")
        return texts.refused(reason);
    if (state === "closed")
        return texts.closed(reason);
    if (state === "connecting" && wasConnected)
        return texts.connectionLost;
    if (state === "connecting")
        return texts.connecting(session.hasFailed ? reason : "");
    if (session.display === undefined)
        return texts.noDisplays;
    if (session.displayIsGone)
        return texts.displayIsGone(session.display.name);
    if (session.state === "lost")
        return texts.playbackLost(session.latestStats?.detail ?? "");
    if (session.latestStats?.link === "down")
        return texts.linkDown(session.latestStats.detail);
    return "";
}
