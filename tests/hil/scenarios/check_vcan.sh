# A check of 20 repeats over a virtual CAN.
. ./common.sh
. ./bench.sh
use_vcan
full_check
