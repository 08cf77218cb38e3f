// SPDX-License-Identifier: GPL-2.0
/*
 * A GPIO chip of the virtual bench: eight lines whose levels outside of the chip a scenario sets and reads
 * through sysfs. Debian's kernels have no gpio-sim.
 *
 * In /sys/devices/platform/bench-gpio:
 *   pull     write "LINE LEVEL": the level outside of the chip, as a switch would set it; an edge interrupts
 *   levels   read: the eight levels, line 0 first
 *   broken   write a mask: these lines cannot be read, as behind a bus that fails
 *
 * A line that is released keeps its level, as many real chips do.
 */
#include <linux/bits.h>
#include <linux/gpio/driver.h>
#include <linux/interrupt.h>
#include <linux/irq.h>
#include <linux/irqdesc.h>
#include <linux/module.h>
#include <linux/platform_device.h>
#include <linux/spinlock.h>

#define LINES 8

struct bench_gpio {
	struct gpio_chip chip;
	raw_spinlock_t lock;
	unsigned long inputs;
	unsigned long levels;
	unsigned long broken;
	unsigned long masked;
	unsigned int edges[LINES];
};

static int bench_get_direction(struct gpio_chip *chip, unsigned int line)
{
	struct bench_gpio *bench = gpiochip_get_data(chip);

	return bench->inputs & BIT(line) ? GPIO_LINE_DIRECTION_IN : GPIO_LINE_DIRECTION_OUT;
}

static int bench_direction_input(struct gpio_chip *chip, unsigned int line)
{
	struct bench_gpio *bench = gpiochip_get_data(chip);
	unsigned long flags;

	raw_spin_lock_irqsave(&bench->lock, flags);
	bench->inputs |= BIT(line);
	raw_spin_unlock_irqrestore(&bench->lock, flags);
	return 0;
}

static void bench_set(struct gpio_chip *chip, unsigned int line, int level)
{
	struct bench_gpio *bench = gpiochip_get_data(chip);
	unsigned long flags;

	raw_spin_lock_irqsave(&bench->lock, flags);
	__assign_bit(line, &bench->levels, level);
	raw_spin_unlock_irqrestore(&bench->lock, flags);
}

static int bench_direction_output(struct gpio_chip *chip, unsigned int line, int level)
{
	struct bench_gpio *bench = gpiochip_get_data(chip);
	unsigned long flags;

	raw_spin_lock_irqsave(&bench->lock, flags);
	bench->inputs &= ~BIT(line);
	__assign_bit(line, &bench->levels, level);
	raw_spin_unlock_irqrestore(&bench->lock, flags);
	return 0;
}

static int bench_get(struct gpio_chip *chip, unsigned int line)
{
	struct bench_gpio *bench = gpiochip_get_data(chip);

	return bench->broken & BIT(line) ? -EIO : !!(bench->levels & BIT(line));
}

static int bench_set_config(struct gpio_chip *chip, unsigned int line, unsigned long config)
{
	return 0; /* whatever bias: the scenario decides the level */
}

static void bench_irq_mask(struct irq_data *data)
{
	struct gpio_chip *chip = irq_data_get_irq_chip_data(data);
	struct bench_gpio *bench = gpiochip_get_data(chip);

	set_bit(irqd_to_hwirq(data), &bench->masked);
	gpiochip_disable_irq(chip, irqd_to_hwirq(data));
}

static void bench_irq_unmask(struct irq_data *data)
{
	struct gpio_chip *chip = irq_data_get_irq_chip_data(data);
	struct bench_gpio *bench = gpiochip_get_data(chip);

	gpiochip_enable_irq(chip, irqd_to_hwirq(data));
	clear_bit(irqd_to_hwirq(data), &bench->masked);
}

static int bench_irq_set_type(struct irq_data *data, unsigned int type)
{
	struct bench_gpio *bench = gpiochip_get_data(irq_data_get_irq_chip_data(data));

	if (type & ~IRQ_TYPE_EDGE_BOTH)
		return -EINVAL;
	bench->edges[irqd_to_hwirq(data)] = type;
	return 0;
}

static const struct irq_chip bench_irq_chip = {
	.name = "bench-gpio",
	.irq_mask = bench_irq_mask,
	.irq_unmask = bench_irq_unmask,
	.irq_set_type = bench_irq_set_type,
	.flags = IRQCHIP_IMMUTABLE,
	GPIOCHIP_IRQ_RESOURCE_HELPERS,
};

static ssize_t pull_store(struct device *device, struct device_attribute *attribute, const char *text, size_t count)
{
	struct bench_gpio *bench = dev_get_drvdata(device);
	unsigned int line, level, edge = 0;
	unsigned long flags;

	if (sscanf(text, "%u %u", &line, &level) != 2 || line >= LINES || level > 1)
		return -EINVAL;
	raw_spin_lock_irqsave(&bench->lock, flags);
	if (bench->inputs & BIT(line)) {
		if (!!(bench->levels & BIT(line)) != level)
			edge = level ? IRQ_TYPE_EDGE_RISING : IRQ_TYPE_EDGE_FALLING;
		__assign_bit(line, &bench->levels, level);
	}
	raw_spin_unlock_irqrestore(&bench->lock, flags);
	if ((bench->edges[line] & edge) && !test_bit(line, &bench->masked))
		generic_handle_domain_irq_safe(bench->chip.irq.domain, line);
	return count;
}
static DEVICE_ATTR_WO(pull);

static ssize_t levels_show(struct device *device, struct device_attribute *attribute, char *text)
{
	struct bench_gpio *bench = dev_get_drvdata(device);
	unsigned int line;

	for (line = 0; line < LINES; line++)
		text[line] = bench->levels & BIT(line) ? '1' : '0';
	text[LINES] = '\n';
	return LINES + 1;
}
static DEVICE_ATTR_RO(levels);

static ssize_t broken_store(struct device *device, struct device_attribute *attribute, const char *text, size_t count)
{
	struct bench_gpio *bench = dev_get_drvdata(device);
	int error = kstrtoul(text, 0, &bench->broken);

	return error ? error : count;
}
static DEVICE_ATTR_WO(broken);

static struct attribute *bench_attrs[] = {
	&dev_attr_pull.attr, &dev_attr_levels.attr, &dev_attr_broken.attr, NULL
};
ATTRIBUTE_GROUPS(bench);

static int bench_probe(struct platform_device *device)
{
	struct bench_gpio *bench = devm_kzalloc(&device->dev, sizeof(*bench), GFP_KERNEL);
	struct gpio_irq_chip *irq;

	if (!bench)
		return -ENOMEM;
	raw_spin_lock_init(&bench->lock);
	bench->inputs = GENMASK(LINES - 1, 0);
	bench->masked = bench->inputs;
	bench->chip.label = "bench-gpio";
	bench->chip.parent = &device->dev;
	bench->chip.owner = THIS_MODULE;
	bench->chip.base = -1;
	bench->chip.ngpio = LINES;
	bench->chip.get_direction = bench_get_direction;
	bench->chip.direction_input = bench_direction_input;
	bench->chip.direction_output = bench_direction_output;
	bench->chip.get = bench_get;
	bench->chip.set = bench_set;
	bench->chip.set_config = bench_set_config;
	irq = &bench->chip.irq;
	gpio_irq_chip_set_chip(irq, &bench_irq_chip);
	irq->handler = handle_simple_irq;
	irq->default_type = IRQ_TYPE_NONE;
	platform_set_drvdata(device, bench);
	return devm_gpiochip_add_data(&device->dev, &bench->chip, bench);
}

static struct platform_driver bench_driver = {
	.probe = bench_probe,
	.driver = { .name = "bench-gpio", .dev_groups = bench_groups },
};

static struct platform_device *bench_device;

static int __init bench_init(void)
{
	int error = platform_driver_register(&bench_driver);

	if (error)
		return error;
	bench_device = platform_device_register_simple("bench-gpio", PLATFORM_DEVID_NONE, NULL, 0);
	if (IS_ERR(bench_device)) {
		platform_driver_unregister(&bench_driver);
		return PTR_ERR(bench_device);
	}
	return 0;
}
module_init(bench_init);

MODULE_DESCRIPTION("GPIO chip of clampd's virtual bench");
MODULE_LICENSE("GPL");
