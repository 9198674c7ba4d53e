function [force, m] = jenkins(p, m, from, to, v)
% Sliders in parallel; remembers their stretches. Slips but the first are ratios of the one before.
slip = cumprod(p(2:2:end));
m = min(max(m + (to - from), -slip), slip);
force = sum(p(1:2:end) .* m);
end
