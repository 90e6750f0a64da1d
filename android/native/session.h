/* A session: the objects of one variant on a device, and what is true of them between two calls. */

#ifndef DRESSI_SESSION_H
#define DRESSI_SESSION_H

#include "gpu.h"

/* A plan's commands for one choice of current slots. */
typedef struct Recording {
    struct Recording *next;
    uint8_t *parity; /* of the plan's `slots` */
    VkCommandBuffer commands;
    VkDescriptorPool sets;
    VkFramebuffer *framebuffers; /* one a stage */
    VkBuffer counts;             /* a command for each draw or dispatch that has a count */
    VkDeviceMemory count_memory;
} Recording;

typedef struct PlanState {
    Indices reads, inputs; /* values that it or a plan it needs reads; of them the inputs */
    Indices touches;       /* values that it reads or updates itself */
    Indices slots;         /* its images that are held twice */
    uint64_t *seen, runs, skipped;
    bool has_seen, kept, out; /* seen: versions of `reads` when it ran; out: of an enter, that its copies are newer than the states */
    Recording *recordings;
} PlanState;

typedef struct Staging { VkBuffer buffer; VkDeviceMemory memory; uint8_t *view; uint64_t size; } Staging;

typedef struct Cache {
    VkPipelineCache handle;
    size_t size;     /* of what is in the file */
    char *folder;    /* NULL: there is none */
    uint8_t key[32];
    char state[300]; /* for the report */
} Cache;

struct dressi_session {
    dressi_device *device;
    bool owns_device, is_closed;
    int process;
    pthread_mutex_t lock;
    uint32_t arrived, entered; /* calls that wait or waited for the lock, and those that have had it */
    char closed[450];          /* why it is closed */
    Bundle bundle;
    Variant *v;
    char **why;
    VkFormat depth;
    Arena scratch; /* of one call */

    VkCommandPool pool;
    VkFence fence;
    VkCommandBuffer commands; /* for transfers */
    bool is_busy;             /* something was submitted that nobody has waited for */
    Staging staging;
    uint64_t largest; /* bytes of the largest value */

    VkImage (*images)[2];
    VkImageView (*views)[2];
    VkDeviceMemory memory[VK_MAX_MEMORY_TYPES];
    uint64_t image_bytes;
    VkSampler *samplers;
    VkShaderModule *modules;
    VkRenderPass *passes;
    VkDescriptorSetLayout *set_layouts; /* one a pipeline; equal ones are those of `shared` */
    VkPipelineLayout *layouts;
    uint32_t *shared;
    VkPipeline *pipelines;
    VkDescriptorSetLayout *compute_sets; /* one a compute, as the next two */
    VkPipelineLayout *compute_layouts;
    VkPipeline *computes;
    Cache cache;

    uint8_t *parity;   /* by image */
    uint64_t *version; /* by value */
    bool *given;       /* by value: it has one */
    PlanState *plans;
    int64_t *held, *shown, *counted; /* by slot of the window, by turn, by value: a view, a view, steps; -1: not known. NULL: no window */
    dressi_read read;                /* NULL: the caller sets what the window and turns stand for */
    void *context;
    Indices phases; /* plans */
    int phase;      /* which of them is the current one, or -1 */
};

typedef dressi_session Session;

/* session.c: one call after another; a failure with DRESSI_LOST closes the session */
dressi_code serial(Session *s, void (*work)(Session *s, Call *call, void *arguments), void *arguments, dressi_error *error);
void *spare(Session *s, Call *call, uint64_t count, size_t size); /* until the call ends */

/* work.c: the queue, memory and transfers */
/* To its current slot: all its texels, or one that they are like. */
typedef struct Copy { uint32_t image; const uint8_t *data; bool texel; } Copy;

void start(Session *s, Call *call);                          /* begins the buffer for transfers */
void send(Session *s, Call *call, const VkCommandBuffer *commands, uint32_t count); /* submits; `settle` waits */
void settle(Session *s, Call *call);
void finish(Session *s, Call *call);                         /* ends the buffer for transfers, submits it and waits */
void barrier(const Session *s, VkCommandBuffer commands);
void reserve(Session *s, Call *call, uint64_t size);
void trim(Session *s, uint64_t size);
void upload(Session *s, Call *call, const Copy *copies, uint32_t count); /* in one submission, all or none */
uint64_t place(uint64_t *at, const Image *image);            /* where in the staging buffer the next image lies */
void copy_in(Session *s, const uint32_t *images, uint32_t count);        /* records, from the staging buffer */
void copy_out(Session *s, const uint32_t *images, uint32_t count);       /* records, to it */
VkImage current(const Session *s, uint32_t image);

/* objects.c */
void create_work(Session *s, Call *call);
void create_images(Session *s, Call *call); /* and begins to clear them */
void create_pipelines(Session *s, Call *call);
void destroy_objects(Session *s);

/* record.c */
VkCommandBuffer recording(Session *s, Call *call, uint32_t plan, bool flipped); /* flipped: of the states that it updates */
void destroy_recordings(Session *s, uint32_t plan);

/* cache.c */
void open_cache(Session *s, Call *call, const char *folder);
void keep_cache(Session *s);
void close_cache(Session *s);

/* window.c */
bool is_streamed(const Session *s, uint32_t value); /* it is brought by `look`, and in no checkpoint */
void open_window(Session *s, Call *call);
void forget_window(Session *s, uint32_t value);     /* what it knows of a value, or of all (UINT32_MAX) */
uint64_t look(Session *s, Call *call, uint32_t plan, uint64_t n); /* brings what at most n iterations need; how many */
void run_steps(Session *s, Call *call, uint32_t plan, uint64_t n);
size_t picture_bytes(const Session *s);

/* running.c */
void prepare_plans(Session *s, Call *call);
void run_plan(Session *s, Call *call, uint32_t plan, uint64_t n, bool prepared);
void run_if_changed(Session *s, Call *call, uint32_t plan, bool prepared);
void give_back(Session *s, Call *call, Indices values); /* brings these states up to date of which a phase has newer copies */

#endif
