/* Counts the instructions of the guest between two markers: a QEMU TCG plugin (API 1: QEMU 4.2 to 8.2).
 *
 *   gcc -O2 -fPIC -shared -o counter.so counter.c
 *   qemu-system-arm ... -plugin counter.so,out=FILE
 *
 * Markers are the Thumb hints DBG #1 (f3af 80f1) and DBG #2 (f3af 80f2), which do nothing on silicon. Each region is
 * a line of FILE, a decimal number: the instructions strictly between the markers. The few declarations of the plugin
 * interface that are used stand here, so that no header of QEMU is needed.
 */
#include <inttypes.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

typedef uint64_t plugin_id;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
struct qemu_info;

extern void qemu_plugin_register_vcpu_tb_trans_cb(plugin_id, void (*)(plugin_id, struct qemu_plugin_tb *));
extern void qemu_plugin_register_vcpu_insn_exec_cb(struct qemu_plugin_insn *, void (*)(unsigned, void *), int, void *);
extern void qemu_plugin_register_vcpu_insn_exec_inline(struct qemu_plugin_insn *, int, void *, uint64_t);
extern size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
extern struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
extern const void *qemu_plugin_insn_data(const struct qemu_plugin_insn *);

__attribute__((visibility("default"))) int qemu_plugin_version = 1;

static uint64_t count, count_at_begin;
static int open_region;
static FILE *out;

static void begin(unsigned cpu, void *unused)
{
    (void)cpu, (void)unused;
    count_at_begin = count;
    open_region = 1;
}

static void end(unsigned cpu, void *unused)
{
    (void)cpu, (void)unused;
    if (open_region) {
        fprintf(out, "%" PRIu64 "\n", count - count_at_begin);
        fflush(out);
    }
    open_region = 0;
}

static void translate(plugin_id id, struct qemu_plugin_tb *block)
{
    (void)id;
    for (size_t i = 0; i < qemu_plugin_tb_n_insns(block); i++) {
        struct qemu_plugin_insn *insn = qemu_plugin_tb_get_insn(block, i);
        const uint8_t *b = qemu_plugin_insn_data(insn);
        /* The first halfword says whether a second follows. */
        unsigned first = b[0] | b[1] << 8;
        unsigned second = first >> 11 >= 0x1d ? b[2] | b[3] << 8 : 0;
        if (first == 0xf3af && second == 0x80f1)
            qemu_plugin_register_vcpu_insn_exec_cb(insn, begin, 0, 0);
        else if (first == 0xf3af && second == 0x80f2)
            qemu_plugin_register_vcpu_insn_exec_cb(insn, end, 0, 0);
        else
            qemu_plugin_register_vcpu_insn_exec_inline(insn, 0, &count, 1);
    }
}

__attribute__((visibility("default"))) int qemu_plugin_install(plugin_id id, const struct qemu_info *info, int argc,
                                                               char **argv)
{
    (void)info;
    for (int i = 0; i < argc; i++)
        if (!strncmp(argv[i], "out=", 4))
            out = fopen(argv[i] + 4, "w");
    if (!out)
        return -1;
    qemu_plugin_register_vcpu_tb_trans_cb(id, translate);
    return 0;
}
