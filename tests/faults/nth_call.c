/* Counts the calls of a process that change files below a folder, and makes the n-th one fail or kill the process.
 *
 *   cc -shared -fPIC -o nth_call.so nth_call.c
 *   LD_PRELOAD=nth_call.so ...; the process calls nth_call_arm(folder, n, fault) and nth_call_count().
 *
 * Faults: 0 none, -1 SIGKILL instead of the call, -2 SIGKILL after half of it (a write) or all of it, else this errno.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum { FILES = 65536, KILLED = -1, TORN = -2 };

static char folder[4096];
static size_t folder_length;
static atomic_long count;
static long wanted;
static int fault;
static atomic_char below[FILES]; /* file descriptors */

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

void nth_call_arm(const char *path, long n, int how)
{
    snprintf(folder, sizeof folder, "%s/", path);
    folder_length = strlen(folder);
    wanted = n;
    fault = how;
    count = 0;
}

long nth_call_count(void) { return count; }

static void die(void)
{
    raise(SIGKILL);
    for (;;)
        pause();
}

static int is_below(const char *path) { return folder_length && path && !strncmp(path, folder, folder_length); }
static int is_open_below(int file) { return file >= 0 && file < FILES && below[file]; }

/* Counts a call; returns whether it is the one to fail. Kills the process if that is to happen before the call. */
static int is_due(void)
{
    if (++count != wanted || !fault)
        return 0;
    if (fault == KILLED)
        die();
    return 1;
}

#define CHANGE(condition, call, failed)                                                                                \
    do {                                                                                                               \
        if ((condition) && is_due()) {                                                                                 \
            if (fault == TORN) {                                                                                       \
                (void)!(call);                                                                                         \
                die();                                                                                                 \
            }                                                                                                          \
            errno = fault;                                                                                             \
            return failed;                                                                                             \
        }                                                                                                              \
        return call;                                                                                                   \
    } while (0)

static int note(int file, const char *path, int flags)
{
    if (file >= 0 && file < FILES)
        below[file] = is_below(path) && (flags & O_ACCMODE) != O_RDONLY;
    return file;
}

static int open_noted(int (*next)(const char *, int, ...), const char *path, int flags, mode_t mode)
{
    if (is_below(path) && (flags & O_ACCMODE) != O_RDONLY && is_due()) {
        if (fault == TORN) {
            next(path, flags, mode);
            die();
        }
        errno = fault;
        return -1;
    }
    return note(next(path, flags, mode), path, flags);
}

#define OPEN(name)                                                                                                     \
    int name(const char *path, int flags, ...)                                                                         \
    {                                                                                                                  \
        va_list rest;                                                                                                  \
        va_start(rest, flags);                                                                                         \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, mode_t) : 0;                                        \
        va_end(rest);                                                                                                  \
        return open_noted(NEXT(name), path, flags, mode);                                                              \
    }
OPEN(open)
OPEN(open64)

int close(int file)
{
    if (file >= 0 && file < FILES)
        below[file] = 0;
    return NEXT(close)(file);
}

static size_t part_of(size_t size) { return fault == TORN && count == wanted ? size / 2 : size; }

ssize_t write(int file, const void *from, size_t size)
{
    CHANGE(is_open_below(file), NEXT(write)(file, from, part_of(size)), -1);
}

#define PWRITE(name, offset_type)                                                                                      \
    ssize_t name(int file, const void *from, size_t size, offset_type at)                                              \
    {                                                                                                                  \
        CHANGE(is_open_below(file), NEXT(name)(file, from, part_of(size), at), -1);                                    \
    }
PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

ssize_t writev(int file, const struct iovec *parts, int number)
{
    CHANGE(is_open_below(file), NEXT(writev)(file, parts, number), -1);
}

int fsync(int file) { CHANGE(is_open_below(file), NEXT(fsync)(file), -1); }
int fdatasync(int file) { CHANGE(is_open_below(file), NEXT(fdatasync)(file), -1); }
int ftruncate(int file, off_t size) { CHANGE(is_open_below(file), NEXT(ftruncate)(file, size), -1); }
int ftruncate64(int file, off64_t size) { CHANGE(is_open_below(file), NEXT(ftruncate64)(file, size), -1); }
int rename(const char *from, const char *to) { CHANGE(is_below(from), NEXT(rename)(from, to), -1); }
int link(const char *from, const char *to) { CHANGE(is_below(to), NEXT(link)(from, to), -1); }
int unlink(const char *path) { CHANGE(is_below(path), NEXT(unlink)(path), -1); }
int mkdir(const char *path, mode_t mode) { CHANGE(is_below(path), NEXT(mkdir)(path, mode), -1); }
