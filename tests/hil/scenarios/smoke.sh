# The bench itself: a real-time kernel, real SocketCAN, and time that the host's load cannot disturb.
. ./common.sh

expect "the kernel is PREEMPT_RT" grep -q 1 /sys/kernel/realtime
expect "vcan exists" ip link add dev vcan0 type vcan
expect "vcan comes up" ip link set vcan0 up

candump -L -n 2 vcan0,0:0,#FFFFFFFF >/tmp/candump.log &
candump_pid=$!
sleep 0.2
expect "a frame is sent" cansend vcan0 123#DEADBEEF
expect "an error frame is injected" cansend vcan0 20000040#0000000000000000
wait $candump_pid
cat /tmp/candump.log
expect "the frame arrives" grep -q '123#DEADBEEF' /tmp/candump.log
expect "the error frame arrives" grep -q '20000040#0000000000000000' /tmp/candump.log

worst_us=$(cyclictest_max 80 2)
cat /tmp/cyclictest.log
# An idle guest wakes up within 30 us of virtual time at this instruction rate; the host's load must not show.
at_most "cyclictest's maximum in us, 2,000 cycles" "$worst_us" 60
