/* Refuses what some file systems refuse, below the folder in the variable REFUSED_BELOW.
 *
 *   cc -shared -fPIC -o refusals.so refusals.c
 *   LD_PRELOAD=refusals.so REFUSED=inodes ...
 *
 * REFUSED: `inodes`, no new file or folder while the file in REFUSED_WHEN exists; `maps`, no shared memory map;
 * `permissions`, files that everybody may read whatever they are created or changed to.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static int refuses(const char *what)
{
    const char *refused = getenv("REFUSED");
    return refused && !strcmp(refused, what);
}

static int is_below(const char *path)
{
    const char *folder = getenv("REFUSED_BELOW");
    return folder && path && !strncmp(path, folder, strlen(folder));
}

static int is_full(const char *path)
{
    const char *when = getenv("REFUSED_WHEN");
    return refuses("inodes") && is_below(path) && when && !access(when, F_OK) && access(path, F_OK);
}

static int open_refused(int (*next)(const char *, int, ...), const char *path, int flags, mode_t mode)
{
    if (flags & O_CREAT && is_full(path)) {
        errno = ENOSPC;
        return -1;
    }
    if (refuses("permissions") && is_below(path))
        mode |= 0044;
    return next(path, flags, mode);
}

#define OPEN(name)                                                                                                     \
    int name(const char *path, int flags, ...)                                                                         \
    {                                                                                                                  \
        va_list rest;                                                                                                  \
        va_start(rest, flags);                                                                                         \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, mode_t) : 0;                                        \
        va_end(rest);                                                                                                  \
        return open_refused(NEXT(name), path, flags, mode);                                                            \
    }
OPEN(open)
OPEN(open64)

int mkdir(const char *path, mode_t mode)
{
    if (is_full(path)) {
        errno = ENOSPC;
        return -1;
    }
    return NEXT(mkdir)(path, mode);
}

int chmod(const char *path, mode_t mode)
{
    if (refuses("permissions") && is_below(path)) {
        errno = EPERM;
        return -1;
    }
    return NEXT(chmod)(path, mode);
}

int fchmod(int file, mode_t mode)
{
    if (refuses("permissions")) {
        errno = EPERM;
        return -1;
    }
    return NEXT(fchmod)(file, mode);
}

#define MMAP(name, offset_type)                                                                                        \
    void *name(void *address, size_t size, int protection, int flags, int file, offset_type at)                        \
    {                                                                                                                  \
        char link[64], path[4096] = "";                                                                                \
        if (flags & MAP_SHARED && file >= 0 && refuses("maps")) {                                                      \
            snprintf(link, sizeof link, "/proc/self/fd/%d", file);                                                     \
            (void)!readlink(link, path, sizeof path - 1);                                                              \
            if (is_below(path)) {                                                                                      \
                errno = ENODEV;                                                                                        \
                return MAP_FAILED;                                                                                     \
            }                                                                                                          \
        }                                                                                                              \
        return NEXT(name)(address, size, protection, flags, file, at);                                                 \
    }
MMAP(mmap, off_t)
MMAP(mmap64, off64_t)
