function [force, m] = square(p, m, from, to, v)
% Spring c y^2.
force = p(1) * to^2;
end
