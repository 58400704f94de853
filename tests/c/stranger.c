// No plugin: loading it would end the process.
#include <stdlib.h>

__attribute__((constructor)) static void start(void) { abort(); }
