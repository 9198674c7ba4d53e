"""A fleet: the posteriors of several runs, one unit each, as one tree on logarithms.

What `fleet_of` returns and `fleet.nc` holds, an `xr.DataTree`:

At the root, attributes

    format    1, of this description
    laws      JSON list of the laws of the joint, the same in every run
    units     JSON: parameter to the SI unit of the value whose logarithm is held
    symbols   JSON: parameter to its symbol for people
    meanings  JSON: parameter to what it is, in a few words
    versions  JSON: package to its version, the same in every run (jbw and what it computes with)
    left_out  JSON: quantity to the units whose draws are not all positive, so that nobody has its
              logarithm; it is in none of the variables

coordinates

    unit       name of each run, unique: that of its folder; in the order given
    parameter  omega_n, zeta, the laws' own parameters, their products (`alpha_delta`) and their
               other coordinates (`softening` = alpha delta/omega_n^2), `gain` where every run
               inferred it; those that every run has, positive in all of its draws

and variables

    torque       (unit)  [N m], NaN where no run states one; one that some state alone is refused
    sequence     (unit)  number of the tightening, NaN where not stated
    temperature  (unit)  [degC], NaN where not stated
    assembly     (unit)  name of the assembly, empty where not stated
    verdict      (unit)  of the run: ok, usable, failed, not assessed
    sampling     (unit)  the same of the computation alone, of `jbw`'s answers; empty in old runs
    num_draws    (unit)  draws of the unit, all of equal weight
    ess          (unit)  effective draws of the parameter of the posterior that has fewest
    mean         (unit, parameter)  of the natural logarithms
    covariance   (unit, parameter, other)  of them; `other` has the names of `parameter`
    lower, upper (unit, parameter)  logarithms of the bounds of the uniform prior where the parameter
                 itself was sampled, NaN where it was not; lower is -inf where the bound is not
                 positive
    beyond       (unit, parameter)  probability beyond these bounds of a Gaussian in the sampled
                 coordinate (no logarithm) of the draws' mean and sd: near 0 where the prior leaves
                 the posterior alone, some 0.04 and more where it cuts it; NaN where not sampled
    run_scatter  (unit, parameter)  sd over the runs within the unit, over the mean, of omega_n and
                 zeta where the unit has several runs; NaN elsewhere

A group for each unit, `/<unit>`, with

    draws  (draw, parameter)  natural logarithms, chains one after the other; as many as the run has
    attributes  campaign (its name), folder (of the run), source (the campaign file)

Logarithms of monomials are sums of those of their factors: ln(alpha delta/omega_n^2) is
`draws.sel(parameter="alpha_delta") - 2 draws.sel(parameter="omega_n")`. The uniform prior in theta
has the density exp(sum ln theta) over ln theta: nothing here takes it out.
"""
