.class public final Ldressi/Device;
.super Ljava/lang/Object;

# interfaces
.implements Ljava/lang/AutoCloseable;


# instance fields
.field private handle:J


# direct methods
.method static constructor <clinit>()V
    .registers 1

    const-string v0, "dressi"

    invoke-static {v0}, Ljava/lang/System;->loadLibrary(Ljava/lang/String;)V

    return-void
.end method

.method public constructor <init>(Ljava/lang/String;)V
    .registers 4

    invoke-direct {p0}, Ljava/lang/Object;-><init>()V

    invoke-static {p1}, Ldressi/Device;->open(Ljava/lang/String;)J

    move-result-wide v0

    iput-wide v0, p0, Ldressi/Device;->handle:J

    return-void
.end method

.method private static native close(J)V
.end method

.method private static native driver(J)Ljava/lang/String;
.end method

.method private static native name(J)Ljava/lang/String;
.end method

.method private static native open(Ljava/lang/String;)J
.end method

.method private static native profile(JLjava/lang/String;Ljava/lang/String;)Ljava/lang/String;
.end method


# virtual methods
.method public declared-synchronized close()V
    .registers 7

    const-wide/16 v4, 0x0

    monitor-enter p0

    :try_start_3
    iget-wide v0, p0, Ldressi/Device;->handle:J

    const-wide/16 v2, 0x0

    iput-wide v2, p0, Ldressi/Device;->handle:J

    cmp-long v2, v0, v4

    if-eqz v2, :cond_10

    invoke-static {v0, v1}, Ldressi/Device;->close(J)V
    :try_end_10
    .catchall {:try_start_3 .. :try_end_10} :catchall_12

    :cond_10
    monitor-exit p0

    return-void

    :catchall_12
    move-exception v0

    monitor-exit p0

    throw v0
.end method

.method public driver()Ljava/lang/String;
    .registers 3

    invoke-virtual {p0}, Ldressi/Device;->handle()J

    move-result-wide v0

    invoke-static {v0, v1}, Ldressi/Device;->driver(J)Ljava/lang/String;

    move-result-object v0

    return-object v0
.end method

.method declared-synchronized handle()J
    .registers 5

    monitor-enter p0

    :try_start_1
    iget-wide v0, p0, Ldressi/Device;->handle:J

    const-wide/16 v2, 0x0

    cmp-long v0, v0, v2

    if-nez v0, :cond_14

    new-instance v0, Ljava/lang/IllegalStateException;

    const-string v1, "the device is closed"

    invoke-direct {v0, v1}, Ljava/lang/IllegalStateException;-><init>(Ljava/lang/String;)V

    throw v0
    :try_end_11
    .catchall {:try_start_1 .. :try_end_11} :catchall_11

    :catchall_11
    move-exception v0

    monitor-exit p0

    throw v0

    :cond_14
    :try_start_14
    iget-wide v0, p0, Ldressi/Device;->handle:J
    :try_end_16
    .catchall {:try_start_14 .. :try_end_16} :catchall_11

    monitor-exit p0

    return-wide v0
.end method

.method public name()Ljava/lang/String;
    .registers 3

    invoke-virtual {p0}, Ldressi/Device;->handle()J

    move-result-wide v0

    invoke-static {v0, v1}, Ldressi/Device;->name(J)Ljava/lang/String;

    move-result-object v0

    return-object v0
.end method

.method public profile(Ljava/lang/String;Ljava/lang/String;)Ljava/lang/String;
    .registers 5

    invoke-virtual {p0}, Ldressi/Device;->handle()J

    move-result-wide v0

    invoke-static {v0, v1, p1, p2}, Ldressi/Device;->profile(JLjava/lang/String;Ljava/lang/String;)Ljava/lang/String;

    move-result-object v0

    return-object v0
.end method
