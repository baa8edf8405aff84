/* Example: messages of a session as bytes, without a network. */
#include <stdio.h>

#include "tactile_client.h"

static void show(const char *what, const uint8_t *bytes, size_t size) {
  printf("%-8s", what);
  for (size_t i = 0; i < size; i++) printf("%02x%s", bytes[i], i + 1 < size ? " " : "\n");
}

/* What a program does with each message that its WebSocket receives. */
static void receive(const uint8_t *data, size_t size) {
  static uint8_t memory[4096];
  tactile_answer answer;
  tactile_status status = tactile_decode(data, size, &answer, memory, sizeof memory);
  if (status != TACTILE_OK) {
    printf("not decoded, status %d\n", (int)status);
  } else if (answer.type == TACTILE_TYPE_WELCOME) {
    tactile_text session = answer.as.welcome.session;
    printf("welcome as %.*s\n", (int)session.size, session.data);
  } else if (answer.type == TACTILE_TYPE_EVENT) {
    tactile_event event = answer.as.event;
    printf("%.*s: %.*s\n", (int)event.display.size, event.display.data, (int)event.kind.size,
           event.kind.data);
  } else if (answer.type == TACTILE_TYPE_TELEMETRY) {
    tactile_telemetry telemetry = answer.as.telemetry;
    printf("finger at %g, %g mm\n", telemetry.position_mm.first, telemetry.position_mm.second);
  }
}

int main(void) {
  static const char welcome[] =
      "\207\244type\247welcome\246server\251tactile 1\247version\001\247session\242a1\250display"
      "s\220\247may_arm\303\247time_us\000";
  static const char event[] = "\203\244type\245event\247display\245right\244kind\245armed";
  static const char telemetry[] =
      "\212\244type\251telemetry\247display\245right\247time_us\000\245state\245armed\253positio"
      "n_mm\222\313@(\000\000\000\000\000\000\313@ \000\000\000\000\000\000\255velocity_mm_s\222"
      "\313\000\000\000\000\000\000\000\000\313\000\000\000\000\000\000\000\000\256normal_force_"
      "n\313\077\340\000\000\000\000\000\000\250shear_um\221\313\077\370\000\000\000\000\000\000"
      "\247drive_v\221\313@\042\000\000\000\000\000\000\250counters\201\246blocks\007";
  uint8_t out[1024];
  tactile_text display = tactile_text_of("right");
  tactile_layer oak = {.texture = tactile_text_of("wood-oak"), .has_gain = true, .gain = 0.5};
  tactile_hello hello = {.client = tactile_text_of("example")};
  tactile_select select = {.display = display, .layers = {&oak, 1}};
  tactile_arm arm = {.display = display};
  tactile_contact contact = {.display = display, .position_mm = {12, 8}, .normal_force_n = 0.5};
  tactile_estop estop = {0}; /* all displays */
  /* High voltage: arm only if the person at the display knows of it. */
  show("hello", out, tactile_encode_hello(&hello, out, sizeof out));
  show("select", out, tactile_encode_select(&select, out, sizeof out));
  show("arm", out, tactile_encode_arm(&arm, out, sizeof out));
  show("contact", out, tactile_encode_contact(&contact, out, sizeof out));
  show("estop", out, tactile_encode_estop(&estop, out, sizeof out));
  receive((const uint8_t *)welcome, sizeof welcome - 1);
  receive((const uint8_t *)event, sizeof event - 1);
  receive((const uint8_t *)telemetry, sizeof telemetry - 1);
  return 0;
}
