#!/bin/sh
# Compiles the library and the launcher into a folder: compile.sh FOLDER. CC names the compiler.
set -e
# initfirst: no library of the program begins before ours.
here=$(dirname "$0")
${CC:-cc} -O2 -std=gnu11 -fno-strict-aliasing -shared -fPIC -fvisibility=default -Wl,-z,initfirst -o "$1/libfleet_preload.so" "$here"/*.c
${CC:-cc} -O2 -std=gnu11 -fno-strict-aliasing -o "$1/fleet_launch" "$here"/launcher/launch.c
