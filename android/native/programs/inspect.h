/* For people: what a bundle is made of, and whether it is sound. Both read the file anew, without a device. */

#ifndef DRESSI_INSPECT_H
#define DRESSI_INSPECT_H

#include "inside.h"

void inspect(Call *call, const char *path, const char *pin);
void verify(Call *call, const char *path, const char *pin);

#endif
