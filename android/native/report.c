/* What a session did and occupies, as JSON with the keys of the Python session's report(). */

#include "session.h"

#include <stdlib.h>

static void say_counts(Session *s, Text *text, bool skipped) {
    bool first = true;
    say(text, ", \"%s\": {", skipped ? "skipped" : "runs");
    for (uint32_t k = 0; k < s->v->plan_count; k++) {
        const Plan *plan = s->v->plans + k;
        if (skipped && plan->purpose != GIVES && plan->purpose != ENTER) continue;
        say(text, first ? "" : ", ");
        say_json(text, plan->name);
        say(text, ": %llu", (unsigned long long)(skipped ? s->plans[k].skipped : s->plans[k].runs));
        first = false;
    }
    say(text, "}");
}

static void make_report(Session *s, Call *call, void *arguments) {
    Text *text = arguments;
    say(text, "{\"device\": ");
    say_json(text, s->device->properties.deviceName);
    say(text, ", \"driver\": ");
    say_json(text, s->device->driver_info);
    say(text, ", \"profile\": ");
    say_json(text, s->v->profile);
    say(text, ", \"variants\": {");
    for (uint32_t k = 0; k < s->bundle.variant_count; k++) {
        say(text, k ? ", " : "");
        say_json(text, s->bundle.variants[k].profile);
        say(text, ": ");
        say_json(text, s->why[k]);
    }
    say(text, "}, \"phase\": ");
    if (s->phase < 0) say(text, "null");
    else say_json(text, s->v->plans[s->phases.at[s->phase]].name);
    say_counts(s, text, false);
    say_counts(s, text, true);
    say(text, ", \"image_bytes\": %llu, \"staging_bytes\": %llu, \"pipelines\": %u, \"pipeline_cache\": ",
        (unsigned long long)s->image_bytes,
        (unsigned long long)s->staging.size, s->v->pipeline_count + s->v->compute_count);
    say_json(text, s->cache.state);
    say(text, "}");
    if (text->broken) fail(call, DRESSI_MEMORY, "no memory for the report");
}

char *dressi_report(dressi_session *s, dressi_error *error) {
    Text text = {0};
    if (!serial(s, make_report, &text, error)) return text.at;
    free(text.at);
    return NULL;
}
