/* Counts the instructions of the guest between two markers: a QEMU TCG plugin for the plugin interfaces 1 to 7
 * (QEMU 4.2 to 11).
 *
 *   cc -O2 -fPIC -shared -DDECLARED=2 -o counter.so counter.c
 *   qemu-system-arm ... -plugin counter.so,out=FILE     counts
 *   qemu-system-arm ... -plugin counter.so,ask=FILE     writes the versions that QEMU takes, and ends with an error
 *
 * Markers are the Thumb hints DBG #1 (f3af 80f1) and DBG #2 (f3af 80f2), which do nothing on silicon. Each region is
 * a line of FILE, a decimal number: the instructions strictly between the markers.
 *
 * QEMU takes a plugin whose declared version lies between the oldest and the newest that it knows, and then speaks its
 * newest. So DECLARED only opens the door; what is called follows the newest version:
 *
 *   1        counts are added at an address
 *   2        counts are added to a scoreboard, one entry a core (QEMU 9.0)
 *   3 to 6   the bytes of an instruction are copied (QEMU 9.1 to 10.2)
 *   7        the callback of a translation has no plugin number, and user data (QEMU 11)
 *
 * The functions of QEMU are looked up by name, so that one source serves all, without a header of QEMU. They are those
 * of `include/plugins/qemu-plugin.h` in QEMU's source.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <inttypes.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#ifndef DECLARED
#define DECLARED 1
#endif
/* The newest version whose functions are known. */
#define NEWEST 7

typedef uint64_t plugin_id;
struct block;
struct insn;
/* One number in each entry of a scoreboard. */
struct entry {
    void *scoreboard;
    size_t offset;
};
/* The begin of what QEMU says about itself. */
struct info {
    const char *target;
    int oldest, newest;
};

__attribute__((visibility("default"))) int qemu_plugin_version = DECLARED;

static size_t (*block_len)(const struct block *);
static struct insn *(*block_insn)(const struct block *, size_t);
static const void *(*insn_data)(const struct insn *);
static size_t (*insn_copy)(const struct insn *, void *, size_t);
static void (*call_at)(struct insn *, void (*)(unsigned, void *), int, void *);
static void (*add_at_address)(struct insn *, int, void *, uint64_t);
static void (*add_to_entry)(struct insn *, int, struct entry, uint64_t);
static uint64_t (*sum_of_entry)(struct entry);

static uint64_t address;
static struct entry entry;
static uint64_t count_at_begin;
static int open_region;
static FILE *out;

static uint64_t count(void)
{
    return sum_of_entry ? sum_of_entry(entry) : address;
}

static void begin(unsigned cpu, void *unused)
{
    (void)cpu, (void)unused;
    count_at_begin = count();
    open_region = 1;
}

static void end(unsigned cpu, void *unused)
{
    (void)cpu, (void)unused;
    if (open_region) {
        fprintf(out, "%" PRIu64 "\n", count() - count_at_begin);
        fflush(out);
    }
    open_region = 0;
}

static void translate(const struct block *block)
{
    for (size_t i = 0; i < block_len(block); i++) {
        struct insn *insn = block_insn(block, i);
        uint8_t b[4] = {0};
        if (insn_copy) {
            insn_copy(insn, b, sizeof b);
        } else {
            /* The first halfword says whether a second follows. */
            const uint8_t *data = insn_data(insn);
            memcpy(b, data, (data[0] | data[1] << 8) >> 11 >= 0x1d ? 4 : 2);
        }
        unsigned first = b[0] | b[1] << 8, second = b[2] | b[3] << 8;
        if (first == 0xf3af && second == 0x80f1)
            call_at(insn, begin, 0, 0);
        else if (first == 0xf3af && second == 0x80f2)
            call_at(insn, end, 0, 0);
        else if (add_to_entry)
            add_to_entry(insn, 0, entry, 1);
        else
            add_at_address(insn, 0, &address, 1);
    }
}

static void translate_by_id(plugin_id id, const struct block *block)
{
    (void)id;
    translate(block);
}

static void translate_by_data(const struct block *block, void *unused)
{
    (void)unused;
    translate(block);
}

/* Looks a function of QEMU up; `missing` becomes its name if there is none. */
static void *function(const char *name, const char **missing)
{
    void *found = dlsym(RTLD_DEFAULT, name);
    if (!found)
        *missing = name;
    return found;
}

static int start(plugin_id id, int newest)
{
    const char *missing = 0;
    block_len = function("qemu_plugin_tb_n_insns", &missing);
    block_insn = function("qemu_plugin_tb_get_insn", &missing);
    call_at = function("qemu_plugin_register_vcpu_insn_exec_cb", &missing);
    void *data = function("qemu_plugin_insn_data", &missing);
    void *at_translation = function("qemu_plugin_register_vcpu_tb_trans_cb", &missing);
    void *(*new_scoreboard)(size_t) = 0;
    if (newest >= 2) {
        new_scoreboard = function("qemu_plugin_scoreboard_new", &missing);
        add_to_entry = function("qemu_plugin_register_vcpu_insn_exec_inline_per_vcpu", &missing);
        sum_of_entry = function("qemu_plugin_u64_sum", &missing);
    } else {
        add_at_address = function("qemu_plugin_register_vcpu_insn_exec_inline", &missing);
    }
    if (missing) {
        fprintf(stderr, "the counter found no function %s in this QEMU\n", missing);
        return -1;
    }
    if (newest >= 3)
        insn_copy = data;
    else
        insn_data = data;
    if (new_scoreboard)
        entry.scoreboard = new_scoreboard(sizeof(uint64_t));
    if (newest >= 7)
        ((void (*)(plugin_id, void (*)(const struct block *, void *), void *))at_translation)(id, translate_by_data, 0);
    else
        ((void (*)(plugin_id, void (*)(plugin_id, const struct block *)))at_translation)(id, translate_by_id);
    return 0;
}

__attribute__((visibility("default"))) int qemu_plugin_install(plugin_id id, const struct info *info, int argc,
                                                               char **argv)
{
    for (int i = 0; i < argc; i++) {
        if (!strncmp(argv[i], "ask=", 4)) {
            FILE *answer = fopen(argv[i] + 4, "w");
            if (answer) {
                fprintf(answer, "%d %d\n", info->oldest, info->newest);
                fclose(answer);
            }
            return -1;
        }
        if (!strncmp(argv[i], "out=", 4))
            out = fopen(argv[i] + 4, "w");
    }
    return out && info->newest <= NEWEST ? start(id, info->newest) : -1;
}
