# Variance components by lme4 of a table of checks: brakes within batches, batches, stations, periods, station x period.
# Rscript line.R CHECKS.csv PERIODS, without weights, as lme4 knows no variance of a reading beside that of the residual.
suppressMessages(library(lme4))
arguments <- commandArgs(trailingOnly = TRUE)
checks <- read.csv(arguments[1], check.names = FALSE)
periods <- as.integer(arguments[2])
time <- as.numeric(as.POSIXct(checks$started, format = "%Y-%m-%dT%H:%M:%OSZ", tz = "UTC"))
share <- (time - min(time)) / (max(time) - min(time))
checks$period <- pmin(periods - 1, floor(share * periods))
checks$value <- checks[["p0 [u]"]]
started <- proc.time()[["elapsed"]]
fit <- lmer(value ~ 1 + (1 | serial) + (1 | batch) + (1 | station) + (1 | period) + (1 | station:period), data = checks,
            control = lmerControl(calc.derivs = FALSE))
seconds <- proc.time()[["elapsed"]] - started
parts <- as.data.frame(VarCorr(fit))
deviation <- function(group) parts$sdcor[parts$grp == group]
cat(sprintf("%g %g %g %g %g %g %g\n", deviation("serial"), deviation("batch"), deviation("station"), deviation("period"),
            deviation("station:period"), deviation("Residual"), seconds))
