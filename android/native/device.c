/* Devices: Vulkan's loader, which devices there are, and one of them opened with a graphics queue. */

#include "gpu.h"

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* ---- Results ---- */

const char *result_name(VkResult result) {
    switch (result) {
#define NAME(x) case x: return #x
    NAME(VK_ERROR_OUT_OF_HOST_MEMORY); NAME(VK_ERROR_OUT_OF_DEVICE_MEMORY); NAME(VK_ERROR_INITIALIZATION_FAILED);
    NAME(VK_ERROR_DEVICE_LOST); NAME(VK_ERROR_MEMORY_MAP_FAILED); NAME(VK_ERROR_LAYER_NOT_PRESENT);
    NAME(VK_ERROR_EXTENSION_NOT_PRESENT); NAME(VK_ERROR_FEATURE_NOT_PRESENT); NAME(VK_ERROR_INCOMPATIBLE_DRIVER);
    NAME(VK_ERROR_TOO_MANY_OBJECTS); NAME(VK_ERROR_FORMAT_NOT_SUPPORTED); NAME(VK_ERROR_FRAGMENTED_POOL);
    NAME(VK_ERROR_UNKNOWN); NAME(VK_ERROR_OUT_OF_POOL_MEMORY); NAME(VK_TIMEOUT); NAME(VK_NOT_READY); NAME(VK_INCOMPLETE);
#undef NAME
    default: return "an unknown VkResult";
    }
}

void must(Call *call, VkResult result, const char *name) {
    if (result == VK_SUCCESS) return;
    dressi_code code = result == VK_ERROR_DEVICE_LOST ? DRESSI_LOST
                     : result == VK_ERROR_OUT_OF_HOST_MEMORY || result == VK_ERROR_OUT_OF_DEVICE_MEMORY ||
                       result == VK_ERROR_OUT_OF_POOL_MEMORY || result == VK_ERROR_FRAGMENTED_POOL ? DRESSI_MEMORY : DRESSI_DEVICE;
    fail(call, code, "%s failed with %s (%d)", name, result_name(result), result);
}

/* ---- The loader and an instance ---- */

/* Loaded once and kept: drivers do not survive being unloaded. */
static PFN_vkGetInstanceProcAddr loader(Call *call) {
    static const char *const names[] = {"libvulkan.so.1", "libvulkan.so"};
    for (size_t k = 0; k < COUNT(names); k++) {
        void *library = dlopen(names[k], RTLD_NOW | RTLD_LOCAL), *found = library ? dlsym(library, "vkGetInstanceProcAddr") : NULL;
        PFN_vkGetInstanceProcAddr get;
        memcpy(&get, &found, sizeof get); /* C has no cast between the two */
        if (found) return get;
    }
    fail(call, DRESSI_DEVICE, "no loader of Vulkan is installed: libvulkan.so.1 was not found");
}

static PFN_vkVoidFunction needed(Call *call, PFN_vkVoidFunction found, const char *name) {
    if (!found) fail(call, DRESSI_DEVICE, "the driver of Vulkan has no %s", name);
    return found;
}

typedef struct Found { dressi_device device; VkPhysicalDevice physical[16]; uint32_t count; PFN_vkGetInstanceProcAddr get; } Found;

/* Extends to the 1.1 commands that tell a driver's name, where there are any. */
static VkInstance create_instance(Call *call, Found *f) {
    PFN_vkEnumerateInstanceVersion tell = (PFN_vkEnumerateInstanceVersion)f->get(NULL, "vkEnumerateInstanceVersion");
    uint32_t version = VK_API_VERSION_1_0;
    if (!tell || tell(&version) != VK_SUCCESS) version = VK_API_VERSION_1_0;
    f->device.instance_version = version;
    VkApplicationInfo about = {TYPE(APPLICATION_INFO), .pApplicationName = "dressi_edge", .pEngineName = "dressi_edge",
                               .apiVersion = version < VK_API_VERSION_1_2 ? version : VK_API_VERSION_1_2};
    VkInstanceCreateInfo info = {TYPE(INSTANCE_CREATE_INFO), .pApplicationInfo = &about};
    PFN_vkCreateInstance create = (PFN_vkCreateInstance)needed(call, f->get(NULL, "vkCreateInstance"), "vkCreateInstance");
    VkInstance instance;
    VkResult result = create(&info, NULL, &instance);
    if (result == VK_ERROR_INCOMPATIBLE_DRIVER || result == VK_ERROR_INITIALIZATION_FAILED)
        fail(call, DRESSI_DEVICE, "no Vulkan driver found (vkCreateInstance failed with %s): install one, on Debian mesa-vulkan-drivers",
             result_name(result));
    must(call, result, "vkCreateInstance");
    return instance;
}

static void enumerate(Call *call, Found *f) {
    f->get = loader(call);
    f->device.instance = create_instance(call, f);
    Vulkan *vk = &f->device.vk;
    vk->DestroyInstance = (PFN_vkDestroyInstance)needed(call, f->get(f->device.instance, "vkDestroyInstance"), "vkDestroyInstance");
#define X(name) vk->name = (PFN_vk##name)needed(call, f->get(f->device.instance, "vk" #name), "vk" #name);
    INSTANCE_CALLS(X)
#undef X
    f->count = COUNT(f->physical);
    VkResult result = vk->EnumeratePhysicalDevices(f->device.instance, &f->count, f->physical);
    if (result == VK_ERROR_INITIALIZATION_FAILED) f->count = 0;
    else if (result != VK_INCOMPLETE) must(call, result, "vkEnumeratePhysicalDevices");
}

/* ---- What a device is ---- */

static bool has_extension(const dressi_device *d, VkPhysicalDevice physical, const char *name) {
    uint32_t count = 0;
    bool found = false;
    if (d->vk.EnumerateDeviceExtensionProperties(physical, NULL, &count, NULL) != VK_SUCCESS || !count) return false;
    VkExtensionProperties *all = calloc(count, sizeof *all);
    if (all && d->vk.EnumerateDeviceExtensionProperties(physical, NULL, &count, all) >= 0)
        for (uint32_t k = 0; k < count; k++) found |= !strcmp(all[k].extensionName, name);
    free(all);
    return found;
}

static void read_driver(const Found *f, dressi_device *d) {
    uint32_t version = d->properties.apiVersion < d->instance_version ? d->properties.apiVersion : d->instance_version;
    PFN_vkGetPhysicalDeviceProperties2 get = NULL;
    if (version >= VK_API_VERSION_1_1)
        get = (PFN_vkGetPhysicalDeviceProperties2)f->get(d->instance, "vkGetPhysicalDeviceProperties2");
    if (!get) return;
    VkPhysicalDeviceIDProperties ids = {TYPE(PHYSICAL_DEVICE_ID_PROPERTIES)};
    VkPhysicalDeviceDriverProperties driver = {TYPE(PHYSICAL_DEVICE_DRIVER_PROPERTIES), .pNext = &ids};
    d->has_driver = version >= VK_API_VERSION_1_2 || has_extension(d, d->physical, VK_KHR_DRIVER_PROPERTIES_EXTENSION_NAME);
    d->has_ids = true;
    VkPhysicalDeviceProperties2 all = {TYPE(PHYSICAL_DEVICE_PROPERTIES_2), .pNext = d->has_driver ? (void *)&driver : (void *)&ids};
    get(d->physical, &all);
    memcpy(d->device_uuid, ids.deviceUUID, VK_UUID_SIZE);
    memcpy(d->driver_uuid, ids.driverUUID, VK_UUID_SIZE);
    memcpy(d->driver_name, driver.driverName, sizeof driver.driverName);
    memcpy(d->driver_info, driver.driverInfo, sizeof driver.driverInfo);
}

/* Fills in what can be read of the k-th; its family is UINT32_MAX if it has no graphics. */
static void read_device(Found *f, uint32_t k) {
    dressi_device *d = &f->device;
    VkQueueFamilyProperties families[16];
    uint32_t count = COUNT(families);
    d->physical = f->physical[k], d->number = k;
    d->family = UINT32_MAX, d->has_driver = d->has_ids = d->has_compute = false;
    d->driver_name[0] = d->driver_info[0] = 0;
    d->vk.GetPhysicalDeviceProperties(d->physical, &d->properties);
    d->vk.GetPhysicalDeviceFeatures(d->physical, &d->features);
    d->vk.GetPhysicalDeviceMemoryProperties(d->physical, &d->memory);
    d->vk.GetPhysicalDeviceQueueFamilyProperties(d->physical, &count, families);
    for (uint32_t n = 0; n < count; n++) {
        bool compute = families[n].queueFlags & VK_QUEUE_COMPUTE_BIT;
        if (families[n].queueFlags & VK_QUEUE_GRAPHICS_BIT && (d->family == UINT32_MAX || compute > d->has_compute))
            d->family = n, d->has_compute = compute;
    }
    read_driver(f, d);
    const char *space = *d->driver_name && *d->driver_info ? " " : "";
    if (*d->driver_name || *d->driver_info) snprintf(d->driver, sizeof d->driver, "%s%s%s", d->driver_name, space, d->driver_info);
    else snprintf(d->driver, sizeof d->driver, "driver 0x%x", d->properties.driverVersion);
}

static const char *kind_of(const dressi_device *d) {
    switch (d->properties.deviceType) {
    case VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU: return "discrete";
    case VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU: return "integrated";
    case VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU: return "virtual";
    case VK_PHYSICAL_DEVICE_TYPE_CPU: return "cpu";
    default: return "other";
    }
}

static int rank_of(const dressi_device *d) {
    static const VkPhysicalDeviceType best[] = {VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU, VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU,
                                                VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU, VK_PHYSICAL_DEVICE_TYPE_CPU};
    int k = 0;
    while (k < (int)COUNT(best) && best[k] != d->properties.deviceType) k++;
    return k;
}

static void list_devices(Found *f, Text *text, const char *separator) {
    for (uint32_t k = 0; k < f->count; k++) {
        read_device(f, k);
        say(text, "%s%u: %s (%s)", k ? separator : "", k, f->device.properties.deviceName, kind_of(&f->device));
    }
}

static char lower(char c) { return c >= 'A' && c <= 'Z' ? c + 32 : c; }

static bool contains(const char *name, const char *part) {
    for (; ; name++) {
        size_t k = 0;
        while (part[k] && lower(name[k]) == lower(part[k])) k++;
        if (!part[k]) return true;
        if (!*name) return false;
    }
}

/* ---- One of them, opened ---- */

static void choose_device(Call *call, Found *f, const char *select) {
    bool asked = select, named = false;
    if (!select) select = getenv("DRESSI_DEVICE");
    if (!select) select = "";
    if (!f->count) fail(call, DRESSI_DEVICE, "no Vulkan device found: install a driver, on Debian mesa-vulkan-drivers");
    char *end;
    unsigned long wanted = strtoul(select, &end, 10);
    bool numbered = *select && !*end && wanted < f->count;
    int best = -1, best_rank = 99;
    for (uint32_t k = 0; k < f->count; k++) {
        read_device(f, k);
        if (numbered ? k != wanted : !contains(f->device.properties.deviceName, select)) continue;
        named = true;
        if (f->device.family == UINT32_MAX || rank_of(&f->device) >= best_rank) continue;
        best = k, best_rank = rank_of(&f->device);
    }
    if (best >= 0) { read_device(f, best); return; }
    Text there = {0};
    list_devices(f, &there, "; ");
    char line[400];
    snprintf(line, sizeof line, "%s", there.at ? there.at : "");
    free(there.at);
    if (named) fail(call, DRESSI_DEVICE, "no graphics queue on what is called '%.60s'; there are %s", select, line);
    fail(call, DRESSI_DEVICE, "no Vulkan device is called '%.60s'%s; there are %s", select, asked ? "" : " (from DRESSI_DEVICE)", line);
}

static void connect(Call *call, dressi_device *d) {
    static const char portability[] = "VK_KHR_portability_subset";
    const char *extensions[] = {portability}; /* a device that has it must be told that we know */
    VkDeviceQueueCreateInfo queue = {TYPE(DEVICE_QUEUE_CREATE_INFO), .queueFamilyIndex = d->family, .queueCount = 1,
                                     .pQueuePriorities = (const float[]){1}};
    VkDeviceCreateInfo info = {TYPE(DEVICE_CREATE_INFO), .queueCreateInfoCount = 1, .pQueueCreateInfos = &queue,
                               .enabledExtensionCount = has_extension(d, d->physical, portability), .ppEnabledExtensionNames = extensions};
    MUST(call, &d->vk, CreateDevice, d->physical, &info, NULL, &d->device);
#define X(name) d->vk.name = (PFN_vk##name)needed(call, d->vk.GetDeviceProcAddr(d->device, "vk" #name), "vk" #name);
    DEVICE_CALLS(X)
#undef X
    d->vk.GetDeviceQueue(d->device, d->family, 0, &d->queue);
}

static void close_parts(dressi_device *d) {
    if (d->device && d->vk.DestroyDevice) {
        if (d->vk.DeviceWaitIdle) d->vk.DeviceWaitIdle(d->device); /* lost or not: nothing runs any more */
        d->vk.DestroyDevice(d->device, NULL);
    }
    if (d->instance && d->vk.DestroyInstance) d->vk.DestroyInstance(d->instance, NULL);
}

dressi_device *dressi_device_open(const char *select, dressi_error *error) {
    Call call = {.error = {DRESSI_OK, ""}};
    Found *f = calloc(1, sizeof *f);
    if (!f) {
        if (error) *error = (dressi_error){DRESSI_MEMORY, "no memory for a device"};
        return NULL;
    }
    if (setjmp(call.out)) {
        close_parts(&f->device);
        free(f);
        told(&call, error);
        return NULL;
    }
    enumerate(&call, f);
    choose_device(&call, f, select);
    connect(&call, &f->device);
    pthread_mutex_init(&f->device.lock, NULL);
    f->device.process = (int)getpid();
    told(&call, error);
    return &f->device; /* the first member: what it is freed as */
}

void dressi_device_close(dressi_device *d) {
    if (!d || d->process != (int)getpid()) return;
    close_parts(d);
    pthread_mutex_destroy(&d->lock);
    free(d);
}

const char *dressi_device_name(const dressi_device *d) { return d->properties.deviceName; }
const char *dressi_device_driver(const dressi_device *d) { return d->driver; }
void dressi_free(char *text) { free(text); }

char *dressi_devices(dressi_error *error) {
    Call call = {.error = {DRESSI_OK, ""}};
    Text text = {0};
    Found *f = calloc(1, sizeof *f);
    if (f && !setjmp(call.out)) {
        enumerate(&call, f);
        for (uint32_t k = 0; k < f->count; k++) {
            read_device(f, k);
            say(&text, "%u: %s (%s), %s\n", k, f->device.properties.deviceName, kind_of(&f->device), f->device.driver);
        }
        say(&text, "%s", "");
    }
    if (!f || (text.broken && !call.error.code)) call.error = (dressi_error){DRESSI_MEMORY, "no memory for the list of devices"};
    if (f) close_parts(&f->device);
    free(f);
    if (told(&call, error)) free(text.at), text.at = NULL;
    return text.at;
}

/* ---- For sessions ---- */

VkFormatFeatureFlags features_of(const dressi_device *device, VkFormat format) {
    VkFormatProperties properties;
    device->vk.GetPhysicalDeviceFormatProperties(device->physical, format, &properties);
    return properties.optimalTilingFeatures;
}

uint32_t memory_type(Call *call, const dressi_device *device, uint32_t bits, VkMemoryPropertyFlags wanted) {
    const VkPhysicalDeviceMemoryProperties *m = &device->memory;
    for (int tries = 0; tries < 2; tries++, wanted = 0)
        for (uint32_t k = 0; k < m->memoryTypeCount; k++)
            if (bits >> k & 1 && (m->memoryTypes[k].propertyFlags & wanted) == wanted) return k;
    fail(call, DRESSI_DEVICE, "%s has no memory of type bits %#x", device->properties.deviceName, bits);
}
