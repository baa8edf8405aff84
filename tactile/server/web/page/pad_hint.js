import { byId, showText } from "./dom.js";
import { texts } from "./texts.js";
/** Show on the pad what is missing for something to be felt. */
export function showPadHint(session, finger, selection) {
    const hint = byId("pad-hint");
    const show = () => showText(hint, padHint(session, finger, selection.halves.left));
    session.changed.on(show);
    finger.changed.on(show);
    selection.changed.on(show);
    show();
}
function padHint(session, finger, selected) {
    const { state, latestStats: stats } = session;
    if (state === "offline")
        return texts.padOffline;
    if (state === "estopped")
        return texts.padEstopped;
    if (state === "lost")
        return texts.padLost;
    if (!session.may("play"))
        return texts.padMayNotPlay;
    if (state === "disarmed")
        return selected ? texts.padDisarmed : texts.padSelectAndArm;
    if (finger.touching && stats?.touching && !stats.owner)
        return texts.fingerOfAnother;
    return selected ? "" : texts.padSelect;
}
