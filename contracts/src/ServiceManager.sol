// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {IMatchingPolicy} from "./interfaces/IMatchingPolicy.sol";
import {IOrganization, Terms} from "./interfaces/IOrganization.sol";
import {IServiceListener} from "./interfaces/IServiceListener.sol";
import {
    Hire,
    IServiceManager,
    Outcome,
    Release,
    Service,
    ServiceState
} from "./interfaces/IServiceManager.sol";
import {Texts} from "./libraries/Texts.sol";
import {Units} from "./libraries/Units.sol";
import {WeightTree} from "./libraries/WeightTree.sol";
import {KindId} from "./types/KindId.sol";
import {NO_SERVICE, ServiceId, unpackService} from "./types/ServiceId.sol";
import {NO_TASK, TaskId} from "./types/TaskId.sol";
import {NO_TURN, Turn} from "./types/Turn.sol";
import {MAX_MAJOR, MAX_MINOR, MINOR_BITS, Weight, weigh} from "./types/Weight.sol";

contract ServiceManager is IServiceManager {
    using WeightTree for WeightTree.Tree;

    /// @dev A Service in two words, of which tasks write the second one.
    struct Record {
        address provider;
        /// @dev The price in `_unit`.
        uint64 units;
        KindId kindId;
        ServiceState state;
        /// @dev A task has named it, or its provider, and waited, so that its own queue, or both, have to be looked at.
        Hire hired;
        bool autoAccept;
        Turn turn;
    }

    /// @dev The terms that a service agreed to, and what is left of its bond.
    struct Agreement {
        uint96 bond;
        uint96 penalty;
        uint8 maxFailures;
        /// @dev Penalties that are set aside: so many cases are open.
        uint32 open;
    }

    /// @dev Counted for all services of a provider together, so that a new service does not begin anew.
    struct Provider {
        uint8 missed;
        uint8 failures;
        /// @dev How often it has fallen asleep since the last accepted proof; at most MAX_NAPS.
        uint8 naps;
        /// @dev When it may wake up; 0 while it is awake.
        uint40 asleepUntil;
        /// @dev What it was paid for accepted work of others (64 bits), and what it would have been paid for work that
        /// failed (64 bits), in `_unit`, as of a day (24 bits): both decay. One number, because it is written so.
        uint152 work;
        /// @dev It is somebody's device (see _owners).
        bool owned;
        /// @dev Somebody's device was its own.
        bool owns;
        /// @dev A task has named it and waited for it: each of its services has to look at its queue.
        bool hired;
        /// @dev Another address is paid (see _payouts). Here, because this word is read before each payment.
        bool paidElsewhere;
    }

    /// @dev Idle services of one kind, price and reputation, in order of their places: a linked list, because
    /// services leave it in the middle and DoubleEndedQueue lets go at its ends alone.
    struct Line {
        uint32 first;
        /// @dev Keeps the word of an empty line, which the next service of that price and reputation fills.
        bool used;
        /// @dev The last six at most, 32 bits each, the last of all in the lowest. Only earlier ones know the next by
        /// themselves, so that whoever joins a short line writes to no neighbour: 5,000 gas.
        uint192 latest;
    }

    /// @dev The idle services of a kind. The tree has one key per line, so that the usual case of few prices does
    /// not climb it: price, then the best reputation first. Its weights are the age of the line's first service
    /// (major) and the line's reputation (minor). The oldest line may have the age of an earlier first service.
    struct Idle {
        WeightTree.Tree lines;
        mapping(uint64 key => Line) line;
    }

    /// @notice Services that a provider may have at a time: so many tasks it holds at most. The organization answers
    /// for its own.
    uint256 public constant MAX_SERVICES = 8;
    /// @notice Attempts without a proof, since the last accepted one, after which a provider falls asleep. Its services
    /// are then paused, each as it misses one. So a provider that is not there does not take every attempt of every task.
    uint256 public constant MAX_MISSED = 3;
    /// @notice How long a provider that fell asleep for the second time may not wake up, s. It doubles each time until a
    /// proof is accepted. After the first time there is no wait.
    uint256 public constant COOL_DOWN = 10 minutes;
    /// @notice From this time on the wait does not grow: 21 hours.
    uint256 public constant MAX_NAPS = 8;
    /// @notice Days after which work counts half for the reputation of its provider.
    uint256 public constant HALF_LIFE = 90;
    /// @notice Grades of reputation by which waiting services are compared. More would mean more lines, and each new
    /// one costs whoever comes into it first two words.
    uint256 public constant GRADES = 8;

    /// @dev The gas of a policy; the caller's transaction outlives one that needs more.
    uint256 private constant POLICY_GAS = 500_000;
    /// @dev No service and no task has this number.
    uint256 private constant NOTHING = type(uint256).max;

    /// @dev A newcomer counts as if it had done work for so many tokens well, and as much badly.
    uint256 private constant PRIOR = 100;
    /// @dev Bits of Line.latest.
    uint256 private constant LATEST = 192;
    /// @dev The bits of a reputation that are its grade.
    uint64 private constant GRADE = MAX_MINOR - (uint64((1 << MINOR_BITS) / GRADES) - 1);
    /// @dev The part of work that a day leaves: 2 ** (-1 / HALF_LIFE), times 2 ** 64.
    uint256 private constant DAILY = 18305219661902323056;

    IOrganization public immutable organization;
    IServiceListener public immutable tasks;
    /// @dev Each price is a multiple of this, in the token's smallest unit.
    uint256 private immutable _unit;
    /// @dev PRIOR in `_unit`.
    uint256 private immutable _prior;

    uint256 private _serviceCount;
    mapping(ServiceId serviceId => Record) private _services;
    mapping(ServiceId serviceId => Agreement) private _agreements;
    mapping(KindId kindId => Idle) private _idle;
    mapping(address provider => Provider) private _providers;
    /// @dev Services of a provider that are not retired, in one word; 0 where there is room. Not the organization's.
    mapping(address provider => uint32[MAX_SERVICES]) private _live;
    mapping(address device => address) private _owners;
    /// @dev Only where `paidElsewhere`.
    mapping(address provider => address) private _payouts;
    /// @dev The services that abandoned a task, 32 bits each, the last in the lowest; of more than eight the last eight.
    mapping(TaskId taskId => uint256) private _abandoned;

    modifier onlyTaskManager() {
        if (msg.sender != address(tasks)) revert NotTaskManager(msg.sender);
        _;
    }

    modifier onlyOrganization() {
        if (msg.sender != address(organization)) revert NotOrganization(msg.sender);
        _;
    }

    constructor(IOrganization organization_, IServiceListener tasks_) {
        organization = organization_;
        tasks = tasks_;
        uint256 perToken;
        (_unit, perToken) = Units.unitOf(organization_.token());
        _prior = PRIOR * perToken;
    }

    /// @inheritdoc IServiceManager
    function registerService(
        bytes32 kind,
        uint256 price,
        uint256 maxBond,
        bool autoAccept,
        string calldata description
    ) external returns (ServiceId serviceId) {
        _requireAwake(msg.sender);
        (Terms memory terms, KindId kindId) = organization.admitService(kind, msg.sender);
        if (terms.bond > maxBond) revert BondTooHigh(terms.bond, maxBond);
        _requirePrice(price);
        Texts.requireText(description);
        uint256 count = ++_serviceCount;
        assert(count <= type(uint32).max);
        serviceId = ServiceId.wrap(count);
        if (msg.sender != address(organization)) _replaceLive(msg.sender, NO_SERVICE, serviceId);
        // A word per provider, so that no task pays for it.
        Provider storage p = _providers[msg.sender];
        if (p.work == 0) p.work = _work(0, 0);
        Record storage s = _services[serviceId];
        s.provider = msg.sender;
        _setPrice(s, NO_TURN, price);
        s.kindId = kindId;
        s.state = ServiceState.Active;
        s.autoAccept = autoAccept;
        if (p.hired) s.hired = Hire.Provider;
        emit ServiceRegistered(serviceId, msg.sender, kind, price, autoAccept, description);
        if (terms.bond != 0 || terms.maxFailures != 0) {
            _agreements[serviceId] = Agreement(terms.bond, terms.penalty, terms.maxFailures, 0);
            emit TermsAgreed(serviceId, terms.bond, terms.penalty, terms.maxFailures);
        }
        tasks.onServiceFree(serviceId, msg.sender, kindId, price, _named(serviceId, s));
        if (terms.bond != 0) tasks.holdBond(msg.sender, terms.bond);
    }

    /// @inheritdoc IServiceManager
    function updateService(ServiceId serviceId, uint256 price, ServiceState state) external {
        Record storage s = _get(serviceId);
        address provider = s.provider;
        if (msg.sender != provider) {
            // Whoever lost the provider's key has the bonds back this way, before penalties use them up.
            bool retires = state == ServiceState.Retired && msg.sender == payoutOf(provider);
            if (!retires) revert NotProvider(serviceId, msg.sender, provider);
        }
        if (s.state == ServiceState.Retired) revert ServiceIsRetired(serviceId);
        if (state == ServiceState.None || state > ServiceState.Retired) revert InvalidServiceState(state);
        if (s.state == ServiceState.Suspended && state != ServiceState.Retired) {
            revert ServiceIsSuspended(serviceId);
        }
        if (state == ServiceState.Active) {
            _requireAwake(msg.sender);
            Agreement storage a = _agreements[serviceId];
            if (a.bond < a.penalty) revert BondExhausted(serviceId, a.bond, a.penalty);
        }
        _requirePrice(price);
        _setPrice(s, _leaveLine(serviceId, s), price);
        s.state = state;
        emit ServiceUpdated(serviceId, price, state);
        if (_isAvailable(s)) {
            tasks.onServiceFree(serviceId, provider, s.kindId, price, _named(serviceId, s));
        } else if (state == ServiceState.Retired && s.turn.taskId() == NO_TASK) {
            uint96 bond = _leave(serviceId, s);
            if (bond != 0) tasks.returnBond(payoutOf(provider), bond);
        }
    }

    /// @inheritdoc IServiceManager
    function agree(ServiceId serviceId) external {
        Record storage s = _get(serviceId);
        address provider = s.provider;
        if (msg.sender != provider) revert NotProvider(serviceId, msg.sender, provider);
        if (s.state == ServiceState.Retired) revert ServiceIsRetired(serviceId);
        TaskId taskId = s.turn.taskId();
        if (taskId != NO_TASK) revert ServiceIsBusy(serviceId, taskId);
        // slither-disable-next-line unused-return
        (, KindId current) = organization.admitService(organization.kindNumbered(s.kindId), provider);
        s.turn = _leaveLine(serviceId, s);
        s.kindId = current;
        emit ServiceAgreed(serviceId, current);
        if (!_isAvailable(s)) return;
        tasks.onServiceFree(serviceId, provider, current, _priceOf(s), _named(serviceId, s));
    }

    /// @inheritdoc IServiceManager
    function setPayout(address provider, address payout) external {
        address current = payoutOf(provider);
        if (msg.sender != current) revert NotPayout(provider, msg.sender, current);
        if (payout == address(0)) revert NoPayout(provider);
        _payouts[provider] = payout;
        _providers[provider].paidElsewhere = payout != provider;
        emit PayoutChanged(provider, payout);
    }

    /// @inheritdoc IServiceManager
    function wakeUp() external {
        Provider storage p = _providers[msg.sender];
        if (p.asleepUntil == 0) revert ProviderIsAwake(msg.sender);
        if (block.timestamp < p.asleepUntil) revert ProviderIsAsleep(msg.sender, p.asleepUntil);
        (p.missed, p.asleepUntil) = (0, 0);
        emit ProviderWokeUp(msg.sender);
    }

    /// @inheritdoc IServiceManager
    function suspend(ServiceId serviceId) external onlyOrganization {
        Record storage s = _get(serviceId);
        if (s.state == ServiceState.Retired) revert ServiceIsRetired(serviceId);
        if (s.state == ServiceState.Suspended) revert ServiceIsSuspended(serviceId);
        _suspend(serviceId, s);
    }

    /// @inheritdoc IServiceManager
    function suspendServicesOf(address provider) external onlyOrganization {
        _suspendAll(provider);
    }

    /// @inheritdoc IServiceManager
    function recordOwner(address device, address owner) external onlyOrganization {
        _owners[device] = owner;
        _providers[device].owned = true;
        _providers[owner].owns = true;
    }

    /// @inheritdoc IServiceManager
    function reinstate(ServiceId serviceId) external onlyOrganization {
        Record storage s = _get(serviceId);
        if (s.state != ServiceState.Suspended) revert ServiceNotSuspended(serviceId, s.state);
        Agreement storage a = _agreements[serviceId];
        if (a.bond < a.penalty) revert BondExhausted(serviceId, a.bond, a.penalty);
        _providers[s.provider].failures = 0;
        s.state = ServiceState.Paused;
        emit ServiceReinstated(serviceId);
    }

    /// @inheritdoc IServiceManager
    function reserve(ServiceId serviceId, KindId kindId, uint256 maxPrice, TaskId taskId, Hire hired)
        external
        onlyTaskManager
        returns (ServiceId taker, address provider, uint256 price, bool accepted)
    {
        taker = serviceId == NO_SERVICE ? _longestIdle(kindId, maxPrice) : serviceId;
        if (taker == NO_SERVICE) return (NO_SERVICE, address(0), 0, false);
        Record storage s = _services[taker];
        if (hired == Hire.Provider && !(_isAvailable(s) && _priceOf(s) <= maxPrice)) {
            ServiceId other = _serviceOf(s.provider, s.kindId, maxPrice);
            if (other != NO_SERVICE) (taker, s) = (other, _services[other]);
        }
        bool ofKind = s.kindId == kindId;
        if (hired != Hire.None && s.state == ServiceState.None) revert UnknownService(taker);
        if (hired != Hire.None && !ofKind) {
            revert ServiceOfOtherKind(taker, organization.kindNumbered(kindId));
        }
        price = _priceOf(s);
        if (!_isAvailable(s) || price > maxPrice || !ofKind) {
            if (hired > s.hired) _hire(s, hired);
            return (taker, address(0), 0, false);
        }
        s.turn = _leaveLine(taker, s).withTask(taskId);
        return (taker, s.provider, price, s.autoAccept);
    }

    /// @inheritdoc IServiceManager
    function release(ServiceId serviceId, Outcome outcome, uint256 value, address creator, uint40 place)
        external
        onlyTaskManager
        returns (Release memory r)
    {
        Record storage s = _services[serviceId];
        TaskId taskId = s.turn.taskId();
        Turn turn = s.turn.withTask(NO_TASK);
        if (outcome == Outcome.Completed) turn = turn.withCompleted();
        else if (outcome == Outcome.Rejected) turn = turn.withRejected();
        else if (outcome == Outcome.Expired) turn = turn.withExpired();
        Provider storage p = _providers[s.provider];
        (r.payout, r.penalty) = _count(taskId, serviceId, s, p, outcome, value, creator);
        ServiceState state = s.state;
        if (state == ServiceState.Retired) r.bond = _leave(serviceId, s);
        r.available = state == ServiceState.Active;
        if (r.available && place != 0) turn = _enqueue(serviceId, s, p, turn, place);
        else if (r.available) _offer(r, serviceId, s);
        s.turn = turn;
    }

    /// @inheritdoc IServiceManager
    function conclude(
        ServiceId serviceId,
        TaskId taskId,
        Outcome outcome,
        uint256 value,
        address creator,
        uint96 penalty
    ) external onlyTaskManager returns (Release memory r) {
        Record storage s = _services[serviceId];
        address provider = s.provider;
        Provider storage p = _providers[provider];
        r.payout = _payoutOf(provider, p);
        if (outcome != Outcome.Unjudged) {
            bool accepted = outcome == Outcome.Completed;
            s.turn = accepted ? s.turn.withCompleted() : s.turn.withRejected();
            _note(p, provider, r.payout, accepted, value, creator);
        }
        Agreement storage a = _agreements[serviceId];
        if (penalty != 0) --a.open;
        if (outcome == Outcome.Rejected) {
            r.penalty = penalty;
            if (penalty != 0) emit BondPenalized(serviceId, taskId, penalty);
            _suspendFailing(serviceId, s, a, p.failures);
        } else if (penalty != 0 && s.state == ServiceState.Retired) {
            r.bond = penalty;
            emit BondReturned(serviceId, provider, penalty);
        } else if (penalty != 0) {
            a.bond += penalty;
            emit PenaltyReturned(serviceId, taskId, penalty);
            bool suffices = s.state == ServiceState.Short && a.bond >= a.penalty;
            if (suffices) s.state = p.asleepUntil == 0 ? ServiceState.Active : ServiceState.Paused;
            if (suffices && _isAvailable(s)) _offer(r, serviceId, s);
        }
    }

    /// @inheritdoc IServiceManager
    function countAbandoned(TaskId taskId, ServiceId serviceId, address creator) external onlyTaskManager {
        address able = _services[serviceId].provider;
        if (_isOwn(able, _providers[able], payoutOf(able), creator)) return;
        for (uint256 by = _abandoned[taskId]; by != 0; by >>= 32) {
            address provider = _services[unpackService(uint32(by))].provider;
            if (provider != able) _miss(provider, _providers[provider]);
        }
    }

    /// @inheritdoc IServiceManager
    function enqueue(ServiceId serviceId, uint40 place) external onlyTaskManager {
        Record storage s = _get(serviceId);
        Turn turn = s.turn;
        if (!_isAvailable(s) || turn.place() != 0) revert ServiceNotIdle(serviceId);
        s.turn = _enqueue(serviceId, s, _providers[s.provider], turn, place);
    }

    /// @inheritdoc IServiceManager
    function service(ServiceId serviceId) external view returns (Service memory) {
        Record storage s = _get(serviceId);
        Agreement storage a = _agreements[serviceId];
        return Service({
            provider: s.provider,
            price: _priceOf(s),
            kind: organization.kindNumbered(s.kindId),
            taskId: s.turn.taskId(),
            place: s.turn.place(),
            state: s.state,
            completed: s.turn.completed(),
            rejected: s.turn.rejected(),
            expired: s.turn.expired(),
            reputation: uint8(_reputation(_providers[s.provider])),
            bond: a.bond,
            penalty: a.penalty,
            maxFailures: a.maxFailures,
            failures: _providers[s.provider].failures,
            autoAccept: s.autoAccept
        });
    }

    /// @inheritdoc IServiceManager
    function providerOf(ServiceId serviceId) external view returns (address) {
        return _get(serviceId).provider;
    }

    /// @inheritdoc IServiceManager
    function payoutOf(address account) public view returns (address) {
        return _payoutOf(account, _providers[account]);
    }

    /// @inheritdoc IServiceManager
    function areRelated(address account, address other) external view returns (bool) {
        return account == other || (_hasDevices(_providers[other]) && _areOwners(account, other));
    }

    /// @inheritdoc IServiceManager
    function partyAmong(address[] calldata accounts, ServiceId serviceId, address creator)
        external
        view
        returns (address)
    {
        address provider = _services[serviceId].provider;
        (bool ofCreator, bool ofProvider) =
            (_hasDevices(_providers[creator]), _hasDevices(_providers[provider]));
        for (uint256 i = 0; i < accounts.length; ++i) {
            address account = accounts[i];
            if (account == creator || (ofCreator && _areOwners(account, creator))) return account;
            if (account == provider || (ofProvider && _areOwners(account, provider))) return account;
        }
        return address(0);
    }

    /// @inheritdoc IServiceManager
    function asleepUntil(address provider) external view returns (uint256) {
        return _providers[provider].asleepUntil;
    }

    /// @inheritdoc IServiceManager
    function serviceOf(address provider, bytes32 kind, uint256 maxPrice)
        external
        view
        returns (ServiceId serviceId)
    {
        serviceId = _serviceOf(provider, organization.numberOf(kind), maxPrice);
        if (serviceId == NO_SERVICE) revert ProviderWithoutService(provider, kind);
    }

    /// @inheritdoc IServiceManager
    function serviceCount() external view returns (uint256) {
        return _serviceCount;
    }

    /// @inheritdoc IServiceManager
    function longestIdle(KindId kindId, uint256 maxPrice) external view returns (ServiceId) {
        return _longestIdle(kindId, maxPrice);
    }

    /// @inheritdoc IServiceManager
    function cheapestIdle(KindId kindId, uint256 maxPrice) external view returns (ServiceId) {
        Idle storage idle = _idle[kindId];
        uint64 key = idle.lines.lowest();
        return key > _lastKey(maxPrice) ? NO_SERVICE : unpackService(idle.line[key].first);
    }

    /// @inheritdoc IServiceManager
    function mostReputableIdle(KindId kindId, uint256 maxPrice) external view returns (ServiceId) {
        Idle storage idle = _idle[kindId];
        return unpackService(idle.line[idle.lines.greatestMinor(_lastKey(maxPrice))].first);
    }

    /// @inheritdoc IServiceManager
    function serviceFor(address policy, KindId kindId, uint256 reward) external view returns (ServiceId) {
        return
            ServiceId.wrap(_ask(policy, abi.encodeCall(IMatchingPolicy.serviceFor, (this, kindId, reward))));
    }

    /// @inheritdoc IServiceManager
    function taskFor(ServiceId serviceId) external view returns (TaskId) {
        Record storage s = _get(serviceId);
        return TaskId.wrap(
            _ask(
                address(organization.policy()),
                abi.encodeCall(IMatchingPolicy.taskFor, (tasks, this, s.kindId, serviceId, _priceOf(s)))
            )
        );
    }

    /// @dev The policy's choice. A policy that fails has chosen NOTHING, so that it holds up no work and no money. It
    /// does not fail for want of gas: nobody chooses in its place by giving little.
    function _ask(address policy, bytes memory question) private view returns (uint256 chosen) {
        // It gets 63 of 64 parts of what there is, at most.
        bool enough = gasleft() > POLICY_GAS + POLICY_GAS / 32;
        bool success;
        // By hand, because `try` reverts here on a malformed answer, and copies as much as the policy returns.
        assembly ("memory-safe") {
            success := staticcall(POLICY_GAS, policy, add(question, 32), mload(question), 0, 32)
            success := and(success, eq(returndatasize(), 32))
            chosen := mload(0)
        }
        if (success) return chosen;
        if (!enough) revert TooLittleGas(POLICY_GAS);
        return NOTHING;
    }

    function _longestIdle(KindId kindId, uint256 maxPrice) private view returns (ServiceId) {
        Idle storage idle = _idle[kindId];
        return unpackService(idle.line[idle.lines.greatestMajor(_lastKey(maxPrice))].first);
    }

    /// @dev The cheapest of the provider's services that is free, else any; 0 if it has none.
    function _serviceOf(address provider, KindId kindId, uint256 maxPrice)
        private
        view
        returns (ServiceId serviceId)
    {
        uint32[MAX_SERVICES] memory live = _live[provider];
        uint256 lowest = maxPrice + 1;
        for (uint256 i = 0; i < MAX_SERVICES; ++i) {
            ServiceId each = unpackService(live[i]);
            Record storage s = _services[each];
            if (each == NO_SERVICE || s.kindId != kindId) continue;
            bool better = _isAvailable(s) && _priceOf(s) < lowest;
            if (better) lowest = _priceOf(s);
            if (better || serviceId == NO_SERVICE) serviceId = each;
        }
    }

    /// @dev A task waits for this service, or for any of its provider: for these at most MAX_SERVICES, and later ones.
    function _hire(Record storage s, Hire hired) private {
        if (hired == Hire.Service) {
            s.hired = hired;
            return;
        }
        address provider = s.provider;
        _providers[provider].hired = true;
        uint32[MAX_SERVICES] memory live = _live[provider];
        for (uint256 i = 0; i < MAX_SERVICES; ++i) {
            if (live[i] != 0) _services[unpackService(live[i])].hired = hired;
        }
    }

    /// @dev The service wants another task.
    function _offer(Release memory r, ServiceId serviceId, Record storage s) private view {
        (r.available, r.kindId, r.price, r.named) = (true, s.kindId, _priceOf(s), _named(serviceId, s));
    }

    /// @dev See Release.
    function _named(ServiceId serviceId, Record storage s) private view returns (uint160) {
        Hire hired = s.hired;
        if (hired == Hire.None) return 0;
        return hired == Hire.Service ? uint160(ServiceId.unwrap(serviceId)) : uint160(s.provider);
    }

    function _setPrice(Record storage s, Turn turn, uint256 price) private {
        s.units = uint64(price / _unit);
        s.turn = turn.withLine(uint24(_key(Units.levelFor(price, _unit), 0)));
    }

    /// @dev Behind the other services of its kind, price and reputation. Returns the service's turn with that place.
    function _enqueue(ServiceId serviceId, Record storage s, Provider storage p, Turn turn, uint40 place)
        private
        returns (Turn)
    {
        Idle storage idle = _idle[s.kindId];
        uint64 grade = _reputation(p) & GRADE;
        uint64 key = (turn.line() | MAX_MINOR) ^ grade;
        Line storage line = idle.line[key];
        (uint32 id, uint192 latest) = (serviceId.pack(), line.latest);
        if (latest == 0) {
            (line.first, line.used) = (id, true);
            idle.lines.put(key, _weight(place, grade));
        } else if (latest >> (LATEST - 32) != 0) {
            // The earliest of the latest is one of the others now.
            Record storage earliest = _services[unpackService(uint32(latest >> (LATEST - 32)))];
            earliest.turn = earliest.turn.withNext(uint32(latest >> (LATEST - 64)));
        }
        line.latest = latest << 32 | id;
        return turn.withPlace(place).withLine(uint24(key)).withPrevious(uint32(latest));
    }

    /// @dev Out of its line, wherever it stands, if it waits. Returns the service's turn without that place.
    function _leaveLine(ServiceId serviceId, Record storage s) private returns (Turn turn) {
        turn = s.turn;
        if (turn.place() == 0) return turn;
        Idle storage idle = _idle[s.kindId];
        (uint64 key, uint32 id) = (turn.line(), serviceId.pack());
        Line storage line = idle.line[key];
        (uint32 previous, uint32 next, bool known) = (turn.previous(), turn.next(), true);
        turn = turn.withPlace(0).withNext(0);
        if (next == 0) (next, known) = _leaveLatest(line, id);
        if (line.first != id) {
            if (known) {
                Record storage before = _services[unpackService(previous)];
                before.turn = before.turn.withNext(next);
                if (next == 0) line.latest = previous;
            }
            if (next != 0) {
                Record storage behind = _services[unpackService(next)];
                behind.turn = behind.turn.withPrevious(previous);
            }
        } else if (next == 0) {
            line.first = 0;
            idle.lines.remove(key);
        } else {
            line.first = next;
            // The oldest line keeps its earlier age while it stays the oldest of all.
            if (!idle.lines.isAlone()) {
                Turn oldest = _services[unpackService(next)].turn;
                Weight weight = _weight(oldest.place(), MAX_MINOR - (oldest.line() & MAX_MINOR));
                if (!idle.lines.leads(key, weight)) idle.lines.put(key, weight);
            }
        }
    }

    /// @dev Out of the latest of its line, among which it is. Returns who is behind it, 0 for nobody, and whether the service
    /// before it, if there is one, is none of the latest, and so knows the next by itself.
    function _leaveLatest(Line storage line, uint32 id) private returns (uint32 next, bool known) {
        (uint192 latest, uint256 behind) = (line.latest, 0);
        for (; uint32(latest >> behind) != id; behind += 32) {
            next = uint32(latest >> behind);
        }
        uint192 before = latest >> (behind + 32);
        known = before == 0;
        line.latest = before << behind | (latest & uint192((1 << behind) - 1));
    }

    /// @dev The end of an attempt changes its provider and its service.
    function _count(
        TaskId taskId,
        ServiceId serviceId,
        Record storage s,
        Provider storage p,
        Outcome outcome,
        uint256 value,
        address creator
    ) private returns (address payout, uint96 penalty) {
        address provider = s.provider;
        payout = _payoutOf(provider, p);
        if (outcome == Outcome.Unjudged) return (payout, 0);
        if (outcome == Outcome.Pending) return (payout, _setAside(taskId, serviceId, s));
        if (outcome != Outcome.Abandoned && outcome != Outcome.Missed) {
            _note(p, provider, payout, outcome == Outcome.Completed, value, creator);
            if (outcome == Outcome.Completed) return (payout, 0);
            penalty = _penalize(taskId, serviceId, s, p.failures);
        }
        if (outcome == Outcome.Rejected || provider == address(organization)) return (payout, penalty);
        if (outcome == Outcome.Abandoned) _remember(taskId, serviceId);
        else _miss(provider, p);
        if (p.asleepUntil != 0 && s.state == ServiceState.Active) {
            s.state = ServiceState.Paused;
            emit ServiceFellAsleep(serviceId);
        }
    }

    /// @dev A judged attempt goes into the provider's record.
    function _note(
        Provider storage p,
        address provider,
        address payout,
        bool accepted,
        uint256 value,
        address creator
    ) private {
        bool own = _isOwn(provider, p, payout, creator);
        _rate(p, accepted, value, own);
        if (!accepted) {
            if (p.failures < type(uint8).max) ++p.failures;
        } else if (!own && p.missed | p.failures | p.naps != 0) {
            _forgive(provider, p);
        }
    }

    /// @dev The penalty leaves the bond until the case ends.
    function _setAside(TaskId taskId, ServiceId serviceId, Record storage s)
        private
        returns (uint96 penalty)
    {
        Agreement storage a = _agreements[serviceId];
        penalty = _takePenalty(a);
        if (penalty == 0) return 0;
        ++a.open;
        emit PenaltySetAside(serviceId, taskId, penalty);
        if (a.bond < a.penalty) _runShort(serviceId, s, a);
    }

    /// @dev The rest of the bond secures no other task, until a case ends for which a part of it is set aside.
    function _runShort(ServiceId serviceId, Record storage s, Agreement storage a) private {
        if (s.state != ServiceState.Active) return;
        s.state = ServiceState.Short;
        emit BondRanShort(serviceId, a.bond, a.penalty);
    }

    /// @dev Returns the penalty, or what is left of the bond, which is less by that.
    function _takePenalty(Agreement storage a) private returns (uint96 penalty) {
        penalty = a.penalty < a.bond ? a.penalty : a.bond;
        if (penalty != 0) a.bond -= penalty;
    }

    /// @dev The address that is paid for the provider's work. `p` is what is known of it.
    function _payoutOf(address provider, Provider storage p) private view returns (address) {
        return p.paidElsewhere ? _payouts[provider] : provider;
    }

    /// @dev It counts for nothing unless somebody else can do the task. Once for a service that got it again and again.
    function _remember(TaskId taskId, ServiceId serviceId) private {
        uint256 by = _abandoned[taskId];
        if (uint32(by) != serviceId.pack()) _abandoned[taskId] = by << 32 | serviceId.pack();
    }

    /// @dev A provider is known for work for others, by its value. Nobody pays oneself, or nothing, for a name.
    function _rate(Provider storage p, bool accepted, uint256 value, bool own) private {
        value /= _unit;
        if (value == 0 || own) return;
        (uint256 done, uint256 failed) = _record(p);
        if (accepted) done = Math.min(done + value, type(uint64).max);
        else failed = Math.min(failed + value, type(uint64).max);
        p.work = _work(done, failed);
    }

    /// @dev Whether the creator of a task is its provider, or one owns the other, or somebody owns both, or what the
    /// provider earns goes back to whoever pays.
    function _isOwn(address provider, Provider storage p, address payout, address creator)
        private
        view
        returns (bool)
    {
        // Whoever has nothing to do with devices has nothing to do with the creator's owner either.
        if (!_hasDevices(p) && payout == provider) return creator == provider;
        address payer = _ownerOf(creator);
        return payer == _ownerOf(provider) || payer == payout;
    }

    /// @dev Whether one owns the other, or somebody owns both.
    function _areOwners(address account, address other) private view returns (bool) {
        (address owner, address othersOwner) = (_ownerOf(account), _ownerOf(other));
        return owner == othersOwner || owner == other || account == othersOwner;
    }

    /// @dev The owner of a device; any other account itself.
    function _ownerOf(address account) private view returns (address owner) {
        owner = _owners[account];
        if (owner == address(0)) owner = account;
    }

    /// @dev Whether it is a device, or has had one: nobody else is related to another account.
    function _hasDevices(Provider storage p) private view returns (bool) {
        return p.owned || p.owns;
    }

    /// @dev A proof was accepted, of work for others.
    function _forgive(address provider, Provider storage p) private {
        if (p.asleepUntil != 0) emit ProviderWokeUp(provider);
        (p.missed, p.failures, p.naps, p.asleepUntil) = (0, 0, 0, 0);
    }

    /// @dev A failed attempt costs the penalty of the terms.
    function _penalize(TaskId taskId, ServiceId serviceId, Record storage s, uint256 failures)
        private
        returns (uint96 penalty)
    {
        Agreement storage a = _agreements[serviceId];
        penalty = _takePenalty(a);
        if (penalty != 0) emit BondPenalized(serviceId, taskId, penalty);
        _suspendFailing(serviceId, s, a, failures);
    }

    /// @dev A provider that fails again and again works no more, nor does a service whose bond does not cover another penalty.
    function _suspendFailing(ServiceId serviceId, Record storage s, Agreement storage a, uint256 failures)
        private
    {
        bool repeated = a.maxFailures != 0 && failures >= a.maxFailures;
        bool short = a.bond < a.penalty;
        if (repeated || (short && a.open == 0)) _suspend(serviceId, s);
        else if (short) _runShort(serviceId, s, a);
        if (repeated) _suspendAll(s.provider);
    }

    /// @dev At most MAX_SERVICES. The organization answers for its own.
    function _suspendAll(address provider) private {
        uint32[MAX_SERVICES] memory live = _live[provider];
        for (uint256 i = 0; i < MAX_SERVICES; ++i) {
            ServiceId serviceId = unpackService(live[i]);
            if (serviceId != NO_SERVICE) _suspend(serviceId, _services[serviceId]);
        }
    }

    function _suspend(ServiceId serviceId, Record storage s) private {
        if (s.state == ServiceState.Retired || s.state == ServiceState.Suspended) return;
        s.turn = _leaveLine(serviceId, s);
        s.state = ServiceState.Suspended;
        emit ServiceSuspended(serviceId);
    }

    /// @dev An attempt without a proof, whichever of the provider's services made it.
    function _miss(address provider, Provider storage p) private {
        if (p.missed < MAX_MISSED) ++p.missed;
        if (p.missed < MAX_MISSED || p.asleepUntil != 0) return;
        p.asleepUntil = uint40(block.timestamp + (p.naps == 0 ? 0 : COOL_DOWN << (p.naps - 1)));
        if (p.naps < MAX_NAPS) ++p.naps;
        emit ProviderFellAsleep(provider, p.asleepUntil);
    }

    /// @dev The service is over: its bond is for its provider.
    function _leave(ServiceId serviceId, Record storage s) private returns (uint96 bond) {
        if (s.provider != address(organization)) _replaceLive(s.provider, serviceId, NO_SERVICE);
        bond = _agreements[serviceId].bond;
        if (bond == 0) return 0;
        _agreements[serviceId].bond = 0;
        emit BondReturned(serviceId, s.provider, bond);
    }

    /// @dev Put `next` where `current` is among the provider's services; 0 is room for one.
    function _replaceLive(address provider, ServiceId current, ServiceId next) private {
        uint32[MAX_SERVICES] storage live = _live[provider];
        for (uint256 i = 0; i < MAX_SERVICES; ++i) {
            if (live[i] != current.pack()) continue;
            live[i] = next.pack();
            return;
        }
        revert TooManyServices(provider, MAX_SERVICES);
    }

    function _isAvailable(Record storage s) private view returns (bool) {
        return s.state == ServiceState.Active && s.turn.taskId() == NO_TASK;
    }

    function _get(ServiceId serviceId) private view returns (Record storage s) {
        s = _services[serviceId];
        if (s.provider == address(0)) revert UnknownService(serviceId);
    }

    /// @dev (done + _prior) / (done + failed + 2 _prior) in 64ths, the rule of succession (Laplace): 0 .. 63.
    function _reputation(Provider storage p) private view returns (uint64) {
        (uint256 done, uint256 failed) = _record(p);
        // Both have 64 bits, and so has what a newcomer counts for.
        unchecked {
            done += _prior;
            return uint64((done << MINOR_BITS) / (done + failed + _prior));
        }
    }

    /// @dev The rest today of what the provider has done and failed. By whole days, so that it does not matter
    /// how often it is computed.
    function _record(Provider storage p) private view returns (uint256 done, uint256 failed) {
        uint256 work = p.work;
        (done, failed) = (work >> 88, (work >> 24) & type(uint64).max);
        uint256 elapsed = block.timestamp / 1 days - (work & type(uint24).max);
        if (elapsed == 0) return (done, failed);
        (done, failed) = (done >> (elapsed / HALF_LIFE), failed >> (elapsed / HALF_LIFE));
        uint256 factor = DAILY;
        // slither-disable-next-line weak-prng
        for (elapsed %= HALF_LIFE; elapsed != 0; elapsed >>= 1) {
            if (elapsed & 1 == 1) (done, failed) = (done * factor >> 64, failed * factor >> 64);
            factor = factor * factor >> 64;
        }
    }

    /// @dev Before or at this key are the lines that cost at most `price`.
    function _lastKey(uint256 price) private view returns (uint64) {
        return _key(Units.levelOf(price, _unit), 0);
    }

    /// @dev Cheap before dear, then reputable before not; never 0.
    function _key(uint64 level, uint64 reputation) private pure returns (uint64) {
        return Weight.unwrap(weigh(level + 1, MAX_MINOR - reputation));
    }

    function _priceOf(Record storage s) private view returns (uint96) {
        return uint96(s.units * _unit);
    }

    /// @dev The weight of a line whose first service has this place.
    function _weight(uint40 place, uint64 reputation) private pure returns (Weight) {
        return weigh(MAX_MAJOR - place, reputation);
    }

    function _work(uint256 done, uint256 failed) private view returns (uint152) {
        return uint152(done << 88 | failed << 24 | block.timestamp / 1 days);
    }

    function _requireAwake(address provider) private view {
        uint256 until = _providers[provider].asleepUntil;
        if (until != 0) revert ProviderIsAsleep(provider, until);
    }

    function _requirePrice(uint256 price) private view {
        if (!Units.isPrice(price, _unit)) revert InvalidPrice(price, _unit, Units.max(_unit));
    }
}
