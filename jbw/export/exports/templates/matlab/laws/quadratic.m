function [force, m] = quadratic(p, m, from, to, v)
% Spring c y|y|.
force = p(1) * to * abs(to);
end
