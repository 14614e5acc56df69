#!/bin/sh
# Debian's packages of the emulated cluster (see emulated.py); as root.
set -eu
export DEBIAN_FRONTEND=noninteractive
apt-get update -q
apt-get install -qy --no-install-recommends slurm-wlm slurmdbd munge mariadb-server libfaketime bindfs
