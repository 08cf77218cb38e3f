# The SocketCAN driver against a real kernel: filters, error frames, drops, an interface that goes down or vanishes.
. ./common.sh

ip link add dev vcan0 type vcan
ip link set vcan0 up
export CLAMPD_TEST_CAN=vcan0
expect "the driver's tests on vcan0 pass" test_drivers_can --gtest_filter='RealBus.*:Interface.*' --gtest_brief=1
