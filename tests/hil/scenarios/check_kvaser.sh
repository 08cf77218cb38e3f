# A check of 20 repeats over two real controllers' drivers on one emulated bus.
# qemu: -object can-bus,id=bus0 -device kvaser_pci,canbus=bus0 -device kvaser_pci,canbus=bus0
. ./common.sh
. ./bench.sh
use_kvaser
full_check
